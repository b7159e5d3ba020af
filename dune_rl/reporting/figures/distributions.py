"""Distributions of a metric over episodes: panels are sets of cases, violins and points methods."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.reporting.figures import style
from dune_rl.reporting.figures.results import (
    Results,
    all_rows,
    axis_label,
    method_names,
    name_panels,
)
from dune_rl.reporting.rows import Row, column

# Metrics that are drawn unless others are asked for, where episodes have them.
DEFAULT_METRICS = (
    *("time_to_goal", "clearance", "vertical_roughness", "vort", "smoothness", "collisions"),
    *("spl", "min_actor_gap", "mean_speed", "energy_wh"),
)
_ROW_IN = 0.27
# Above the shapes (1), below the bars (2).
_POINTS_ZORDER = 1.5
_HALF_VIOLIN, _JITTER = 0.36, 0.13
_MOST_POINTS = 200
_GRID = 200
# A density needs some different values.
_LEAST_FOR_DENSITY = 4


def distribution_metrics(results: Results) -> list[str]:
    """Metrics worth a figure: the default ones that some episode has a value of."""
    rows = all_rows(results)
    return [name for name in DEFAULT_METRICS if np.isfinite(column(rows, name)).any()]


def draw_distributions(results: Results, metric: str) -> Figure:
    """The distribution of `metric` over episodes, by cases (panels) and method (rows of a panel).

    Points are episodes (at most 200 of a method), the shape is their smoothed density, the bar goes from the
    first to the third quartile and the light mark is the median. Episodes without a value, such as the time
    to a goal that was not reached, are left out; the numbers on the right are those drawn, of all.
    """
    names = method_names(results)
    values = column(all_rows(results), metric)
    if not names or not np.isfinite(values).any():
        return style.note_figure(f"no episode has a value of {metric}")
    styles = style.method_styles(names)
    with rc_context(style.RC):
        figure, grid, across = style.panel_figure(len(results), 0.45, 0.35 + _ROW_IN * len(names))
        for axes, (title, methods) in zip(grid, results.items(), strict=True):
            _panel(axes, methods, metric, styles)
            axes.set_title(title, loc="left")
        _limit(grid[0], values)
        for axes in grid[::across]:
            axes.set_yticks(range(len(names)), style.short_names(names))
        grid[0].set_ylim(len(names) - 0.45, -0.55)
        name_panels(figure, axis_label(metric), results, across)
    return figure


def _panel(
    axes: Axes, methods: Mapping[str, Sequence[Row]], metric: str, styles: dict[str, style.MethodStyle]
) -> None:
    for place, (name, look) in enumerate(styles.items()):
        if name not in methods:
            continue
        values = column(methods[name], metric)
        seen = values[np.isfinite(values)]
        _draw_method(axes, seen, place, look, name)
        axes.text(
            1.01, place, f"{len(seen)} of {len(values)}", transform=axes.get_yaxis_transform(),
            va="center", ha="left", fontsize=style.SMALL - 1, color=style.FAINT,
        )  # fmt: skip
    style.tidy(axes, "x")
    axes.tick_params(axis="y", length=0)


def _draw_method(axes: Axes, seen: Array, place: int, look: style.MethodStyle, name: str) -> None:
    if not len(seen):
        return
    shape = density(seen)
    if shape is not None:
        x, height = shape
        axes.fill_between(
            x, place - _HALF_VIOLIN * height, place + _HALF_VIOLIN * height, color=look.colour, alpha=0.22,
            linewidth=0,
        )  # fmt: skip
    # The same points at every drawing; of many episodes, some.
    draws = stream(0, "jitter", place)
    shown = seen if len(seen) <= _MOST_POINTS else draws.choice(seen, _MOST_POINTS, replace=False)
    offset = draws.uniform(-_JITTER, _JITTER, len(shown))
    # As nothing is drawn between them, the points of a panel are one picture in a PDF; each picture takes the
    # memory of the whole figure.
    axes.scatter(
        shown, place + offset, s=5, marker=look.mark, color=look.colour, alpha=0.55, linewidths=0,
        label=name, rasterized=True, zorder=_POINTS_ZORDER,
    )  # fmt: skip
    low, middle, high = np.quantile(seen, [0.25, 0.5, 0.75])
    axes.plot([low, high], [place, place], color=style.INK, linewidth=2.2, solid_capstyle="butt")
    axes.plot(
        [middle], [place], "o", color="white", markeredgecolor=style.INK, markersize=3.6, markeredgewidth=0.8
    )


def density(values: Array) -> tuple[Array, Array] | None:
    """Places (G,) and the density there, of at most 1, (G,), within the range of `values`; None for too few.

    A Gaussian kernel of Scott's width, cut off at the smallest and the largest value, as there is nothing
    beyond them.
    """
    if len(np.unique(values)) < _LEAST_FOR_DENSITY:
        return None
    x = np.linspace(values.min(), values.max(), _GRID)
    height = stats.gaussian_kde(values)(x)
    return x, height / height.max()


def _limit(axes: Axes, values: Array) -> None:
    """Limits from 0 where no value is negative and 0 is not far away."""
    seen = values[np.isfinite(values)]
    low, high = float(seen.min()), float(seen.max())
    room = 0.04 * (high - low) or 0.5 * abs(high) or 0.5
    left = -room / 3 if 0.0 <= low < 0.5 * high else low - room
    axes.set_xlim(left, high + room)
