"""What the page of a report is made of, section by section."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

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
