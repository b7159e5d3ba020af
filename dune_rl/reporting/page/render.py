"""Renders sections as one HTML file; all text is escaped by the template."""

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from dune_rl.reporting.tables.table import Table

_PX_PER_IN, _COLUMN_IN = 150, 5.0


@dataclass(frozen=True)
class TextBlock:
    """A paragraph, or a list of `items` under it; a warning stands out."""

    text: str
    items: Sequence[str] = ()
    warning: bool = False
    kind: str = "text"


@dataclass(frozen=True)
class TableBlock:
    """A table; a folded one shows its title alone until it is opened."""

    table: Table
    folded: bool = False
    kind: str = "table"


@dataclass(frozen=True)
class FigureBlock:
    """A figure with title and caption; `name` is the stem of its files, `sources` what it was drawn from."""

    name: str
    title: str
    caption: str
    figure: Figure
    sources: Sequence[Path] = ()
    kind: str = "figure"

    @property
    def width_px(self) -> int:
        """Its width on the page, so that all figures have letters of one size."""
        return round(_PX_PER_IN * float(self.figure.get_figwidth()))

    @property
    def is_wide(self) -> bool:
        """Whether it is wider than a column of a paper."""
        return float(self.figure.get_figwidth()) > _COLUMN_IN


@dataclass(frozen=True)
class HeadingBlock:
    """A heading below that of the section."""

    text: str
    kind: str = "heading"


Block = TextBlock | TableBlock | FigureBlock | HeadingBlock


@dataclass
class Section:
    """A section of the page; `name` is its anchor. One without blocks is left out."""

    name: str
    title: str
    blocks: list[Block] = field(default_factory=list)


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
