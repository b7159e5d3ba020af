"""The page of a report: its sections, and the one HTML file, without network and script, made of them."""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from dune_rl.reporting.tables.table import Table

_PX_PER_IN, _COLUMN_IN = 150, 5.0
_FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class TextBlock:
    """A paragraph, or a list of `items` under it; a warning stands out. An empty list is not shown."""

    text: str
    items: Sequence[str] | None = None
    warning: bool = False
    heading: str = ""
    kind: str = "text"


@dataclass(frozen=True)
class TableBlock:
    """A table; a folded one shows its title alone until it is opened."""

    table: Table
    folded: bool = False
    kind: str = "table"


@dataclass
class FigureBlock:
    """A figure with title and caption; `name` is the stem of its files, `sources` what it is drawn from.

    `own_amount` is what drawing and writing it makes of the report's progress, `further` what else `draw`
    adds to it. When it is drawn, `picture` is its PNG file in base 64, and `width_in` its width [in].
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], Figure]
    sources: Sequence[Path] = ()
    further: float = 0.0
    own_amount: float = 4.0
    picture: str = ""
    width_in: float = 0.0
    kind: str = "figure"

    @property
    def amount(self) -> float:
        """What all of it makes of the report's progress."""
        return self.own_amount + self.further

    @property
    def width_px(self) -> int:
        """Its width on the page, so that all figures have letters of one size."""
        return round(_PX_PER_IN * self.width_in)

    @property
    def is_wide(self) -> bool:
        """Whether it is wider than a column of a paper."""
        return self.width_in > _COLUMN_IN


Block = TextBlock | TableBlock | FigureBlock


@dataclass
class Section:
    """A section of the page; `name` is its anchor. One without blocks is left out."""

    name: str
    title: str
    blocks: list[Block] = field(default_factory=list)


def tables_of(sections: Iterable[Section]) -> list[Table]:
    """All tables of a page, in order."""
    return [block.table for section in sections for block in section.blocks if isinstance(block, TableBlock)]


def figures_of(sections: Iterable[Section]) -> list[FigureBlock]:
    """All figures of a page, in order."""
    return [block for section in sections for block in section.blocks if isinstance(block, FigureBlock)]


def render_page(title: str, summary: Sequence[str], sections: Sequence[Section], date: str) -> str:
    """The HTML of a report whose figures are drawn; all text is escaped by the template."""
    environment = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["shown_path"] = shown_path
    return environment.get_template("page.html").render(
        title=title,
        summary=summary,
        sections=[section for section in sections if section.blocks],
        date=date,
        # A style sheet of ours; text of users' never gets there.
        style=Markup((_FOLDER / "page.css").read_text(encoding="utf-8")),
    )


def shown_path(path: Path) -> str:
    """A path as pages show it: relative to the current folder where it lies below it."""
    return os.path.relpath(path) if path.resolve().is_relative_to(Path.cwd()) else str(path)
