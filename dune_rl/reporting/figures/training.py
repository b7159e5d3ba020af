"""Training curves: success and return over frames, as means and bands over the seeds of a group of runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray
from scipy import stats

from dune_rl.geometry.arrays import Array
from dune_rl.metrics.catalogue import format_range
from dune_rl.reporting.figures import style
from dune_rl.reporting.inputs import TrainingRun
from dune_rl.reporting.rows import Row, is_number
from dune_rl.statistics.intervals import CONFIDENCE

# From this many seeds on, a band is the t interval of the mean; fewer show their range.
SEEDS_FOR_INTERVAL = 5
_ROWS = (("SR", "success rate"), ("return", "return per episode"))
_KINDS = (("eval", "evaluation"), ("train", "training"))


@dataclass(frozen=True)
class Band:
    """Means (F,) over runs at `frames` (F,), and the band from `low` to `high`; `runs` (F,) have a value.

    The band is NaN where one run has a value.
    """

    frames: Array
    mean: Array
    low: Array
    high: Array
    runs: NDArray[np.int64]
    is_interval: bool


def by_world(groups: Mapping[str, Sequence[TrainingRun]]) -> dict[str, dict[str, Sequence[TrainingRun]]]:
    """Groups of runs by the world that they train in: trainings in different worlds are no comparison."""
    found: dict[str, dict[str, Sequence[TrainingRun]]] = {}
    for name, runs in groups.items():
        world = runs[0].config.get("world")
        title = str(world.get("name", "unknown world")) if isinstance(world, Mapping) else "unknown world"
        found.setdefault(title, {})[name] = runs
    return found


def training_band(runs: Sequence[TrainingRun], kind: str, metric: str, group: str = "") -> Band:
    """The band of `metric` over runs, from their rows of `kind`, of a group of agents.

    Between its rows a run is interpolated; it has no value before its first and after its last row.
    """
    curves = [_curve(run.history, kind, metric, group) for run in runs]
    curves = [(frames, values) for frames, values in curves if len(frames)]
    empty = np.zeros(0)
    if not curves:
        return Band(empty, empty, empty, empty, np.zeros(0, np.int64), False)
    frames = np.unique(np.concatenate([frames for frames, _ in curves]))
    values = np.array([np.interp(frames, *curve, left=np.nan, right=np.nan) for curve in curves])
    count = (~np.isnan(values)).sum(axis=0)
    mean = np.nansum(values, axis=0) / count
    is_interval = len(curves) >= SEEDS_FOR_INTERVAL
    if is_interval:
        spread = np.sqrt(np.nansum((values - mean) ** 2, axis=0) / np.maximum(count - 1, 1) / count)
        half = stats.t.ppf((1 + CONFIDENCE) / 2, np.maximum(count - 1, 1)) * spread
        low, high = mean - half, mean + half
        if metric == "SR":
            low, high = np.maximum(low, 0.0), np.minimum(high, 1.0)
    else:
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    alone = count < 2
    return Band(frames, mean, np.where(alone, np.nan, low), np.where(alone, np.nan, high), count, is_interval)


def _curve(history: Sequence[Row], kind: str, metric: str, group: str) -> tuple[Array, Array]:
    rows = [row for row in history if row.get("kind") == kind and str(row.get("group", "")) == group]
    points = np.array([[row["frames"], row.get(metric, np.nan)] for row in rows], float).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.argsort(points[:, 0], kind="stable")]
    return points[:, 0], points[:, 1]


def draw_training_curves(groups: Mapping[str, Sequence[TrainingRun]]) -> Figure:
    """Success rate and return over frames: evaluation on the left, training on the right.

    `groups` are runs that differ in the seed alone, by name. Lines are means over the seeds;
    bands are 95 % t intervals of the mean from 5 seeds on, and the smallest and largest value of fewer.
    Groups of agents have rows of their own.
    """
    runs_of_all = [run for runs in groups.values() for run in runs]
    agents = dict.fromkeys(agent for run in runs_of_all for agent in run.agent_groups)
    shown = [
        (agent, metric, label)
        for agent in agents
        for metric, label in _ROWS
        if any(len(training_band(runs_of_all, kind, metric, agent).frames) for kind, _ in _KINDS)
    ]
    if not shown:
        return style.note_figure("no episode has ended in these trainings")
    styles = style.method_styles(list(groups))
    with rc_context(style.RC):
        height = 0.45 + 1.55 * len(shown) + style.legend_height_in(len(styles), style.PAGE_IN)
        figure = style.new_figure(style.PAGE_IN, height)
        grid = figure.subplots(len(shown), len(_KINDS), sharex=True, sharey="row", squeeze=False)
        for row, (agent, metric, label) in zip(grid, shown, strict=True):
            for axes, (kind, _) in zip(row, _KINDS, strict=True):
                for name, runs in groups.items():
                    _draw(axes, training_band(runs, kind, metric, agent), styles[name], kind, name)
                style.tidy(axes)
                if metric == "SR":
                    style.scale_as_share(axes)
            row[0].set_ylabel(f"{agent}: {label}" if agent else label)
        for axes, (kind, title) in zip(grid[0], _KINDS, strict=True):
            axes.set_title(f"{title}: {_counts(groups, kind)}", loc="left")
        for axes in grid[-1]:
            axes.set_xlabel("frames (control steps of all scenes)")
            axes.set_xlim(left=0)
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        if len(styles) > 1:
            style.draw_legend(figure, styles)
        figure.supxlabel(_caption(groups), fontsize=style.SMALL, x=0.995, ha="right")
    return figure


def _draw(axes: Axes, band: Band, look: style.MethodStyle, kind: str, name: str) -> None:
    if not len(band.frames):
        return
    axes.fill_between(band.frames, band.low, band.high, color=look.colour, alpha=0.2, linewidth=0)
    marks = look.mark if kind == "eval" else ""
    every = max(1, len(band.frames) // 12)
    axes.plot(
        band.frames, band.mean, color=look.colour, linestyle=look.line, linewidth=1.2,  # type: ignore[arg-type]
        marker=marks, markersize=3, markevery=every, label=name,
    )  # fmt: skip


def _counts(groups: Mapping[str, Sequence[TrainingRun]], kind: str) -> str:
    """Episodes behind each point, as the rows of these runs state them."""
    found = [
        int(row["episodes"])
        for runs in groups.values()
        for run in runs
        for row in run.history
        if row.get("kind") == kind and is_number(row.get("episodes"))
    ]
    last = "last " if kind == "train" else ""
    return f"{last}{format_range(found)} episodes a point" if found else "no rows"


def _caption(groups: Mapping[str, Sequence[TrainingRun]]) -> str:
    numbers = [len(runs) for runs in groups.values()]
    if max(numbers) == 1:
        return "one seed each, no band" if len(groups) > 1 else "one seed, no band"
    kinds = []
    if any(1 < number < SEEDS_FOR_INTERVAL for number in numbers):
        kinds.append("smallest to largest")
    if max(numbers) >= SEEDS_FOR_INTERVAL:
        kinds.append("95 % t interval of the mean")
    return f"{format_range(numbers)} seeds; lines: means, bands: {' or '.join(kinds)}"
