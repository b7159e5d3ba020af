"""Success against properties of the episodes, such as the distance to the goal, with intervals."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dune_rl.geometry.arrays import Array
from dune_rl.reporting.figures import style
from dune_rl.reporting.figures.results import Results, all_rows, method_names, name_panels
from dune_rl.reporting.rows import Row, column
from dune_rl.statistics.intervals import Estimate, estimate_proportion
from dune_rl.statistics.measures import cluster_rows

# Properties of episodes: in words, and as the label of an axis.
PROPERTIES = {
    "goal_distance_m": ("the distance to the goal", "straight distance from start to goal [m]"),
    "slope_deg": (
        "the steepest ground on the way to the goal",
        "steepest ground on the straight line to the goal [°]",
    ),
}
_MOST_BINS = 6
# A bin has at least this share of the values.
_LEAST_SHARE = 0.05
# A bin has at least this many episodes of a method, on average.
_LEAST_COUNT = 5
# A property that differs by less does not vary.
_LEAST_RANGE = 1e-3
# Methods of a bin stand side by side over this share of the narrowest bin.
_SPREAD = 0.3
# More methods than these have thinner intervals.
_FEW = 5


def round_edges(values: Array, least: float = 0.0) -> Array:
    """Round edges of at most six bins that hold all values which are not NaN.

    They are of equal width, apart from those that are joined because fewer than a twentieth of the values, or
    than `least`, are in them.
    """
    seen = values[np.isfinite(values)]
    if not len(seen):
        return np.zeros(0)
    edges = MaxNLocator(_MOST_BINS, steps=[1, 2, 2.5, 5, 10]).tick_values(seen.min(), seen.max())
    # The last bin has no right edge of its own, so a value on it needs another.
    first = int(np.searchsorted(edges, seen.min(), side="right")) - 1
    last = int(np.searchsorted(edges, seen.max(), side="right"))
    step = edges[1] - edges[0]
    return _join_sparse(seen, np.append(edges, edges[-1] + step)[max(first, 0) : last + 1], least)


def _join_sparse(values: Array, edges: Array, least: float) -> Array:
    """Edges without some, so that no bin has few values: such a bin is joined to its smaller neighbour."""
    while len(edges) > 2:
        counts = np.histogram(values, edges)[0]
        sparsest = int(counts.argmin())
        if counts[sparsest] >= max(_LEAST_SHARE * len(values), least):
            break
        padded = np.concatenate([[np.inf], counts, [np.inf]])
        to_left = padded[sparsest] <= padded[sparsest + 2]
        edges = np.delete(edges, sparsest if to_left else sparsest + 1)
    return edges


def success_by_bin(rows: Sequence[Row], name: str, edges: Array) -> list[Estimate]:
    """The share of successes, with Wilson's interval, in each bin of the property `name`, from edge to edge.

    Rows without the property or without success are left out.
    """
    values, success = column(rows, name), column(rows, "success")
    known = np.isfinite(values) & np.isfinite(success)
    values, hits = values[known], success[known] > 0
    clusters, _ = cluster_rows([row for row, is_known in zip(rows, known, strict=True) if is_known])
    number = np.searchsorted(edges, values, side="right") - 1
    return [
        estimate_proportion(hits[number == bin], None if clusters is None else clusters[number == bin])
        for bin in range(len(edges) - 1)
    ]


def draw_success_by(results: Results, name: str = "goal_distance_m") -> Figure:
    """Success rate against the property `name` of episodes: panels are cases, and lines are methods.

    Bars are Wilson's 95 % intervals over whole sites; bins with too few sites have none. The numbers at the
    bottom are the episodes in each bin (of one method, or of the smallest and the largest where methods
    differ). Bins are those of all panels.
    """
    _, label = PROPERTIES[name]
    shown = {
        cases: methods
        for cases, methods in results.items()
        if any(np.isfinite(column(rows, name)).any() for rows in methods.values())
    }
    rows = all_rows(shown)
    if not shown or not np.isfinite(column(rows, "success")).any():
        missing = "success" if shown else name
        return style.note_figure(f"no episode has {missing}: evaluate again with this version")
    values = column(rows, name)
    if np.nanmax(values) - np.nanmin(values) < _LEAST_RANGE:
        return style.note_figure(f"{label}: {np.nanmax(values):.3g} in all episodes")
    styles = style.method_styles(method_names(shown))
    edges = round_edges(values, _LEAST_COUNT * len(styles))
    with rc_context(style.RC):
        figure, grid, across = style.panel_figure(len(shown), 0.5, 1.75, len(styles))
        for axes, (cases, methods) in zip(grid, shown.items(), strict=True):
            _panel(axes, methods, name, edges, styles)
            axes.set_title(cases, loc="left")
        grid[0].set_ylim(-0.13, 1.04)
        grid[0].set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
        grid[0].yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
        for axes in grid[::across]:
            axes.set_ylabel("success rate")
        if len(styles) > 1:
            style.draw_legend(figure, styles)
        name_panels(figure, label, shown, across)
    return figure


def _panel(
    axes: Axes,
    methods: Mapping[str, Sequence[Row]],
    name: str,
    edges: Array,
    styles: dict[str, style.MethodStyle],
) -> None:
    narrowest = float(np.diff(edges).min())
    # Side by side within a bin, so that intervals do not hide each other.
    places = {method: place for place, method in enumerate(each for each in styles if each in methods)}
    counts: list[list[int]] = []
    for method, place in places.items():
        bins = success_by_bin(methods[method], name, edges)
        counts.append([one.count for one in bins])
        shift = 0.0 if len(places) == 1 else (place / (len(places) - 1) - 0.5) * _SPREAD
        full = [one.count > 0 for one in bins]
        x = ((edges[:-1] + edges[1:]) / 2 + shift * narrowest)[full]
        y, low, high = np.array([(one.value, one.low, one.high) for one in bins]).T[:, full]
        look = styles[method]
        axes.errorbar(
            x, y, np.abs([low - y, high - y]), color=look.colour, marker=look.mark, markersize=3.2,
            linewidth=1.0, linestyle=look.line, elinewidth=0.9 if len(places) <= _FEW else 0.5, capsize=0,
            label=method,
        )  # fmt: skip
    for low, high, each in zip(edges[:-1], edges[1:], zip(*counts, strict=True), strict=True):
        least, most = min(each), max(each)
        text = f"{most}" if least == most else f"{least}\N{EN DASH}{most}"
        axes.text(
            (low + high) / 2, -0.1, text, ha="center", va="center", fontsize=style.SMALL - 1,
            color=style.FAINT, gid="count",
        )  # fmt: skip
    style.tidy(axes)
    axes.set_xticks(edges)
    axes.set_xlim(edges[0], edges[-1])
    axes.axhline(0.0, color=style.FAINT, linewidth=0.4)
