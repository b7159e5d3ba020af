"""The look of all figures: sizes, fonts, and colours, lines and marks that tell methods apart."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

# Widths of a column and of a page of two columns [in]: printed at these, fonts have their size.
COLUMN_IN, PAGE_IN = 3.45, 7.16
SMALL, NORMAL = 6.5, 7.5
INK, FAINT, GRID = "#1d1d1f", "#6b6b70", "#e3e3e6"
# Okabe & Ito (2008), "Color Universal Design", without yellow, which is too light for lines on white.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#e69f00", "#56b4e9")
_LINES: tuple[object, ...] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
_LONGEST_NAME = 26
# Entries of a legend that fit side by side on a page, at most.
_ACROSS = 4
# Panels side by side, at most.
_MOST_ACROSS = 3
_LEGEND_ROW_IN = 0.17

# Fonts are embedded as outlines that journals accept; give it to `rc_context` when a figure is saved, too.
RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": NORMAL,
    "axes.titlesize": NORMAL,
    "axes.labelsize": NORMAL,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "legend.fontsize": SMALL,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.unicode_minus": True,
    # Names of methods and sets are text, with any dollar sign.
    "text.parse_math": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}


@dataclass(frozen=True)
class MethodStyle:
    """Colour, line style and mark of a method: any one of them with another differs from those of others."""

    colour: str
    line: object
    mark: str


def method_styles(names: Sequence[str]) -> dict[str, MethodStyle]:
    """The styles of methods by name: 12 marks, and 28 pairs of a colour and a line, before they repeat."""
    return {
        name: MethodStyle(
            PALETTE[index % len(PALETTE)], _LINES[index % len(_LINES)], _MARKS[index % len(_MARKS)]
        )
        for index, name in enumerate(dict.fromkeys(names))
    }


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure with a canvas that needs no display; draw on it within `rc_context(RC)`."""
    figure = Figure(figsize=(width_in, height_in), dpi=200, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def note_figure(text: str) -> Figure:
    """A figure that says why there is nothing to draw."""
    with rc_context(RC):
        figure = new_figure(COLUMN_IN, 0.7)
        figure.text(0.5, 0.5, text, ha="center", va="center", color=FAINT, wrap=True)
    return figure


def tidy(axes: Axes, grid: str = "y") -> None:
    """Axes without frame at the top and right, with a faint grid along `grid` ("x", "y", "both" or "")."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_axisbelow(True)
    if grid:
        axes.grid(axis=grid, color=GRID, linewidth=0.5)  # type: ignore[arg-type]


def short_names(names: Iterable[str]) -> list[str]:
    """Names that have room beside an axis: without the folders that all share; of long ones the end."""
    whole = list(names)
    parts = [name.split("/") for name in whole]
    depth = 0
    several = len(whole) > 1
    while several and all(len(p) > depth + 1 for p in parts) and len({p[depth] for p in parts}) == 1:
        depth += 1
    own = ["/".join(each[depth:]) for each in parts]
    return [name if len(name) <= _LONGEST_NAME else "…" + name[-(_LONGEST_NAME - 1) :] for name in own]


def draw_legend(figure: Figure, styles: dict[str, MethodStyle]) -> None:
    """A legend of methods above the panels."""
    handles = [
        Line2D(
            [], [], color=style.colour, linestyle=style.line,  # type: ignore[arg-type]
            marker=style.mark, markersize=3.5, linewidth=1.3,
            # Matplotlib leaves out of legends what begins with an underscore.
            label=f" {name}" if name.startswith("_") else name,
        )
        for name, style in zip(short_names(styles), styles.values(), strict=True)
    ]  # fmt: skip
    across = max(1, min(len(handles), _legend_columns(figure.get_figwidth())))
    # Legends fill columns first; names shall be read along rows.
    ordered = [handle for column in range(across) for handle in handles[column::across]]
    figure.legend(handles=ordered, loc="outside upper center", ncols=across, frameon=False, handlelength=2.8)


def legend_height_in(count: int, width_in: float) -> float:
    """The height that `draw_legend` needs for so many methods in a figure of this width [in]; 0 for one."""
    return _LEGEND_ROW_IN * ceil(count / _legend_columns(width_in)) if count > 1 else 0.0


def _legend_columns(width_in: float) -> int:
    return _ACROSS if width_in > COLUMN_IN + 1 else 2


def scale_as_share(axes: Axes) -> None:
    """A vertical axis from 0 to 100 %."""
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))


def panel_figure(
    count: int, margin_in: float, panel_in: float, methods: int = 1
) -> tuple[Figure, list[Axes], int]:
    """A figure, its `count` panels of one scale, and how many of them are side by side, at most three.

    Panels are `panel_in` [in] high, with titles; all else needs `margin_in`, and the legend of `methods`.
    """
    across = max(1, min(count, _MOST_ACROSS))
    rows = max(1, ceil(count / across))
    width = COLUMN_IN if across == 1 else PAGE_IN
    figure = new_figure(width, margin_in + legend_height_in(methods, width) + panel_in * rows)
    grid = figure.subplots(rows, across, squeeze=False, sharex=True, sharey=True).reshape(-1)
    for axes in grid[count:]:
        axes.remove()
    if count % across:
        # Nothing is below them that would show their common axis.
        for axes in grid[count - across : (rows - 1) * across]:
            axes.xaxis.set_tick_params(labelbottom=True)
    return figure, list(grid[:count]), across
