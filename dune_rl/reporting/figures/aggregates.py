"""Figures of aggregates over several cases: values with intervals, performance profiles, improvements."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from dune_rl.metrics.catalogue import format_range
from dune_rl.reporting.figures import style
from dune_rl.reporting.figures.results import Results, all_rows
from dune_rl.reporting.rows import column
from dune_rl.statistics.aggregates import (
    Scores,
    aggregate_scores,
    performance_profile,
    probability_of_improvement,
    run_scores,
    site_scores,
)
from dune_rl.statistics.intervals import Estimate

# More pairs than these are drawn as a matrix.
_MOST_PAIRS = 10
_THRESHOLDS = 101
_MIDDLE = 0.5


@dataclass(frozen=True)
class MethodScores:
    """The scores of methods by name, and in words what their units are."""

    scores: Mapping[str, Scores]
    units: str


def collect_scores(results: Results, runs: Mapping[str, str] | None = None) -> MethodScores:
    """The success rates of methods.

    `runs` names the method that each trained policy is a run of, such as {"seed1": "SAC", "seed2": "SAC"}. If
    every method has at least two runs on each of its cases, the runs are the units; otherwise the sites are,
    over all runs of a method.
    """
    names = runs or {}
    grouped: dict[str, dict[str, list[str]]] = {}
    for cases, methods in results.items():
        for name in methods:
            grouped.setdefault(names.get(name, name), {}).setdefault(cases, []).append(name)
    by_run = all(len(each) > 1 for cases in grouped.values() for each in cases.values())
    scores = {
        method: {
            cases: run_scores([results[cases][name] for name in members], "success")
            if by_run
            else site_scores([row for name in members for row in results[cases][name]], "success")
            for cases, members in by_cases.items()
        }
        for method, by_cases in grouped.items()
    }
    count = format_range([len(values) for each in scores.values() for values in each.values()])
    sites = np.isfinite(column(all_rows(results), "world_seed")).all()
    kind = "runs" if by_run else "sites" if sites else "sites or episodes"
    return MethodScores(scores, f"{count} {kind} on {len(results)} set{'s' if len(results) > 1 else ''}")


def draw_aggregates(found: MethodScores) -> Figure:
    """Interquartile mean, median, mean and optimality gap of each method, with 95 % bootstrap intervals."""
    values = {name: aggregate_scores(scores) for name, scores in found.scores.items()}
    if not any(one.count for each in values.values() for one in each.values()):
        return style.note_figure("no episode has a value of success")
    styles = style.method_styles(list(values))
    with rc_context(style.RC):
        figure = style.new_figure(style.PAGE_IN, 0.6 + 0.24 * len(values))
        measures = list(next(iter(values.values())))
        grid = figure.subplots(1, len(measures), sharey=True, squeeze=False)[0]
        for axes, measure in zip(grid, measures, strict=True):
            for place, (name, estimates) in enumerate(values.items()):
                _interval(axes, estimates[measure], place, styles[name].colour, styles[name].mark, name)
            better = "lower" if measure == "optimality gap" else "higher"
            axes.set_title(f"{measure} ({better} is better)", loc="left", fontsize=style.SMALL)
            axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            style.tidy(axes, "x")
            axes.tick_params(axis="y", length=0)
        grid[0].set_yticks(range(len(values)), style.short_names(values))
        grid[0].set_ylim(len(values) - 0.5, -0.5)
        figure.supxlabel(f"success rate;  {found.units}", fontsize=style.RC["axes.labelsize"])
    return figure


def draw_profiles(found: MethodScores) -> Figure:
    """Performance profiles: the share of units with a score above each threshold, with its intervals."""
    pooled = [values for scores in found.scores.values() for values in scores.values() if len(values)]
    if not pooled:
        return style.note_figure("no episode has a value of success")
    every = np.concatenate(pooled)
    low, high = min(0.0, float(every.min())), max(1.0, float(every.max()))
    styles = style.method_styles(list(found.scores))
    with rc_context(style.RC):
        figure = style.new_figure(
            style.COLUMN_IN, 2.1 + style.legend_height_in(max(2, len(styles)), style.COLUMN_IN)
        )
        axes = figure.subplots()
        for name, scores in found.scores.items():
            profile = performance_profile(scores, np.linspace(low, high, _THRESHOLDS))
            look = styles[name]
            axes.fill_between(
                profile.thresholds, profile.low, profile.high, color=look.colour, alpha=0.15, linewidth=0,
                step="post",
            )  # fmt: skip
            axes.step(
                profile.thresholds, profile.share, where="post", color=look.colour, linewidth=1.2,
                linestyle=look.line, marker=look.mark, markersize=3, markevery=_THRESHOLDS // 8, label=name,
            )  # fmt: skip
        style.tidy(axes, "both")
        axes.set_xlim(low, high)
        style.scale_as_share(axes)
        axes.set_xlabel("threshold of the success rate")
        axes.set_ylabel("units above the threshold")
        style.draw_legend(figure, styles)
        figure.supxlabel(f"units: {found.units}", fontsize=style.SMALL, x=0.995, ha="right")
    return figure


def draw_improvements(found: MethodScores) -> Figure:
    """How probably a unit of one method scores higher than one of another, for all pairs of methods.

    Up to ten pairs have 95 % bootstrap intervals; more are a matrix (row above column), in which bold numbers
    have an interval without 50 %.
    """
    names = list(found.scores)
    if len(names) < 2:
        return style.note_figure("one method alone: there is nothing to compare")
    pairs = {
        (a, b): probability_of_improvement(found.scores[a], found.scores[b])
        for a, b in combinations(names, 2)
    }
    if not any(one.count for one in pairs.values()):
        return style.note_figure("no two methods have cases in common")
    with rc_context(style.RC):
        figure = _pairs(pairs) if len(pairs) <= _MOST_PAIRS else _matrix(names, pairs)
        figure.supxlabel(f"success rate;  {found.units}", fontsize=style.SMALL)
    return figure


def _pairs(pairs: Mapping[tuple[str, str], Estimate]) -> Figure:
    figure = style.new_figure(style.COLUMN_IN + 1.2, 0.75 + 0.24 * len(pairs))
    axes = figure.subplots()
    right = axes.twinx()
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    labels = dict(zip(names, style.short_names(names), strict=True))
    for place, ((a, b), estimate) in enumerate(pairs.items()):
        _interval(axes, estimate, place, "#0072b2", "o", f"{a} above {b}")
    axes.axvline(_MIDDLE, color=style.FAINT, linewidth=0.7, linestyle=(0, (3, 2)))
    for each, side in ((axes, 0), (right, 1)):
        each.set_yticks(range(len(pairs)), [labels[pair[side]] for pair in pairs])
        each.set_ylim(len(pairs) - 0.5, -0.5)
        style.tidy(each, "x" if side == 0 else "")
        each.tick_params(axis="y", length=0)
    axes.set_xlim(-0.02, 1.02)
    axes.xaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axes.set_xlabel("probability that the left one scores higher")
    return figure


def _matrix(names: list[str], pairs: Mapping[tuple[str, str], Estimate]) -> Figure:
    count = len(names)
    table = np.full((count, count), np.nan)
    figure = style.new_figure(style.PAGE_IN, 1.2 + 0.36 * count)
    axes = figure.subplots()
    for (a, b), one in pairs.items():
        row, across = names.index(a), names.index(b)
        table[row, across], table[across, row] = one.value, 1.0 - one.value
        sure = one.low > _MIDDLE or one.high < _MIDDLE
        for y, x in ((row, across), (across, row)):
            if one.count:
                far = abs(table[y, x] - _MIDDLE) > 0.35
                axes.text(
                    x, y, f"{100 * table[y, x]:.0f}", ha="center", va="center", fontsize=style.SMALL,
                    fontweight="bold" if sure else "normal", color="white" if far else "black",
                )  # fmt: skip
    # Light in the middle and as dark at both ends: red and blue differ for the colour-blind.
    image = axes.imshow(table, cmap="RdBu", vmin=0.0, vmax=1.0, aspect="auto")
    labels = style.short_names(names)
    axes.set_yticks(range(count), labels)
    axes.set_xticks(range(count), labels, rotation=40, ha="right", rotation_mode="anchor")
    axes.tick_params(length=0)
    bar = figure.colorbar(image, ax=axes, format=PercentFormatter(1, decimals=0), pad=0.01)
    bar.set_label("probability that the row scores above the column\n(bold: 95 % interval without 50 %)")
    return figure


def _interval(axes: Axes, estimate: Estimate, place: int, colour: str, mark: str, label: str) -> None:
    if not estimate.count:
        axes.text(
            0.02, place, "no value", transform=axes.get_yaxis_transform(), va="center", color=style.FAINT,
            fontsize=style.SMALL,
        )  # fmt: skip
        return
    axes.plot(
        [estimate.low, estimate.high], [place, place], color=colour, linewidth=4, alpha=0.35,
        solid_capstyle="butt",
    )  # fmt: skip
    axes.plot([estimate.value], [place], mark, color=colour, markersize=4.5, label=label)
