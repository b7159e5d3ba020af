"""Renders sections as one HTML file; all text is escaped by the template."""

import base64
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dune_rl.reporting.page.blocks import Section

_FOLDER = Path(__file__).parent


def render_page(
    title: str, summary: Sequence[str], sections: Sequence[Section], pictures: Mapping[str, bytes], date: str
) -> str:
    """The HTML of a report; `pictures` are the PNG files of its figures, by name."""
    environment = Environment(
        loader=PackageLoader("dune_rl.reporting.page", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["shown_path"] = shown_path
    # A style sheet of ours; text of users' never gets there.
    style = Markup((_FOLDER / "page.css").read_text(encoding="utf-8"))
    return environment.get_template("page.html").render(
        title=title,
        summary=summary,
        sections=[section for section in sections if section.blocks],
        pictures={name: base64.b64encode(data).decode("ascii") for name, data in pictures.items()},
        date=date,
        style=style,
    )


def shown_path(path: Path) -> str:
    """A path as pages show it: relative to the current folder where it lies below it."""
    return os.path.relpath(path) if path.resolve().is_relative_to(Path.cwd()) else str(path)
