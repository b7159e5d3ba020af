"""Tables of methods on the same cases: as in the DUnE paper, all measures, in pairs, and over cases."""

import math
from collections.abc import Mapping, Sequence

from dune_rl.metrics.catalogue import (
    MINUS,
    NOTHING,
    Measure,
    format_difference,
    format_p,
    format_range,
    format_value,
    measure_of,
)
from dune_rl.reporting.comparison import Comparison, files_of
from dune_rl.reporting.figures.results import COLLISION, FAILURES
from dune_rl.reporting.rows import is_number
from dune_rl.reporting.tables.table import Cell, Table, estimate_cell, measure_title
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.paired_comparison import PairedComparison

PAPER_MEASURES = ("SR", "TR", "TC", "MTT", "OC", "VR", "VORT", "TSR")
PAPER = "DUnE paper"
_CAVEAT = (
    "The paper's figures come from another simulator, robot model and metrics code, without intervals: they "
    "give the order of size, not a ranking."
)

# The paper's Table 3 by world and measure. Its TC is a total over an evaluation of 10 minutes.
TABLE_3: Mapping[str, Mapping[str, str]] = {
    "flat": {"SR": "100 %", "TC": "0", "VORT": "0.78", "TSR": "12.82"},
    "inspection": {"SR": "75 %", "TC": "52", "VORT": "0.44", "TSR": "12.43"},
    "island": {"SR": "73 %", "TC": "0", "VORT": "0.61", "TSR": "14.46"},
}
# Those of measures that are ours, too: its VORT is the mean speed everywhere, and its TSR has gravity in it.
PAPER_FIGURES: Mapping[str, Mapping[str, str]] = {
    world: {"SR": told["SR"].removesuffix(" %"), "TC": f"{told['TC']} in all"}
    for world, told in TABLE_3.items()
}


def main_table(name: str, comparison: Comparison) -> Table:
    """The paper's measures: a row for each method, and one with what the paper reports of the same world."""
    figures, estimates = PAPER_FIGURES.get(comparison.cases.world, {}), comparison.estimates
    # What the paper measures and we cannot, as VORT on flat ground, has dashes.
    shown = [
        measure_of(one)
        for one in PAPER_MEASURES
        if one in figures or any(one in found for found in estimates.values())
    ]
    rows = [
        [
            Cell(method.name),
            Cell(f"{method.episodes}" + (f", {method.agents} agents each" if method.agents > 1 else "")),
            *(_estimate(one, method.name, estimates) for one in shown),
        ]
        for method in comparison.methods
    ]
    caption = [_intervals(comparison)]
    if len(comparison.methods) > 1:
        caption.append("The best value is marked, whether or not it differs significantly.")
    if figures:
        rows.append([Cell(PAPER), Cell(""), *(Cell(figures.get(one.name, "")) for one in shown)])
        caption.append(_CAVEAT)
    return Table(
        f"{name}_main",
        comparison.cases.title,
        " ".join(caption),
        ["method", "episodes", *(measure_title(one) for one in shown)],
        rows,
        _data(comparison, [one.name for one in shown]),
        comparison.files,
    )


def all_measures_table(name: str, comparison: Comparison) -> Table:
    """Every measure that some method has: a row for each, and a column for each method."""
    estimates = comparison.estimates
    names = list(dict.fromkeys(one for found in estimates.values() for one in found))
    rows = [
        [
            Cell(measure_title(one)),
            Cell(one.meaning),
            Cell(one.better or ""),
            *(_estimate(one, method.name, estimates) for method in comparison.methods),
        ]
        for one in map(measure_of, names)
    ]
    return Table(
        f"{name}_all",
        f"{comparison.cases.title}: all measures",
        _intervals(comparison),
        ["measure", "meaning", "better is", *(method.name for method in comparison.methods)],
        rows,
        _data(comparison, names),
        comparison.files,
        heads=3,
    )


def paired_table(
    name: str, comparison: Comparison, pairs: Sequence[PairedComparison], *, further: bool = False
) -> Table:
    """Differences of each pair of methods on the same episodes, by measure, of the paper or `further`."""
    rows, data = [], []
    for one in pairs:
        difference = one.difference
        value, low, high = (
            format_difference(one.measure, end) for end in (difference.value, difference.low, difference.high)
        )
        rows.append(
            [
                Cell(measure_title(one.measure)),
                Cell(f"{one.first} {MINUS} {one.second}"),
                Cell(value, "" if math.isnan(difference.low) else f"{low} to {high}"),
                Cell(str(difference.count)),
                Cell(format_p(one.p_value, is_bound=one.p_is_bound), _why_no_p(one)),
                Cell(format_p(one.adjusted_p, is_bound=one.p_is_bound)),
                Cell(NOTHING if math.isnan(one.effect) else f"{one.effect:.2f}".replace("-", MINUS)),
            ]
        )
        data.append(
            {
                "cases": comparison.cases.title,
                "measure": one.measure.name,
                "first": one.first,
                "second": one.second,
                "difference": difference.value,
                "low": difference.low,
                "high": difference.high,
                "pairs": difference.count,
                "p": one.p_value,
                "p_holm": one.adjusted_p,
                "effect": one.effect,
            }
        )
    caption = (
        "Differences with paired 95 % intervals; p of the exact McNemar test for shares and of a "
        "permutation test for the rest, and by Holm's method over all pairs of one measure; effect: for "
        "shares the part of the discordant episodes that the first wins (0.5: none), for means Cohen's d of "
        "paired samples, for ratios their quotient (1: none). Times are compared on the episodes in which "
        "both arrive."
    )
    if any(_why_no_p(one) for one in pairs):
        caption += (
            " Where p has a dash, it is not defined: no episode has a value of both methods (no pairs), or "
            "the sum by which a ratio divides is 0 for one of them (ratio by 0)."
        )
    if comparison.sites:
        caption += f" Intervals and tests, all of permutations, are over {comparison.sites} whole sites."
    return Table(
        f"{name}_pairs",
        f"{comparison.cases.title}: {'further measures ' if further else ''}in pairs",
        caption,
        ["measure", "methods", "difference", "pairs", "p", "p (Holm)", "effect"],
        rows,
        data,
        comparison.files,
        heads=2,
    )


def overview_table(comparisons: Sequence[Comparison], measure: str) -> Table:
    """One measure of all methods on all cases: a row for each method, a column for each set of cases."""
    one = measure_of(measure)
    methods = list(dict.fromkeys(method.name for each in comparisons for method in each.methods))
    counts = [
        f"{each.cases.title}: {format_range([method.episodes for method in each.methods])} episodes"
        for each in comparisons
    ]
    return Table(
        f"overview_{measure}",
        f"{measure_title(one)} of every method on all cases",
        f"{one.meaning.capitalize()}; {', '.join(counts)}. 95 % intervals. A dash: not measured.",
        ["method", *(each.cases.title for each in comparisons)],
        [
            [
                Cell(name),
                *(estimate_cell(one, each.estimates.get(name, {}).get(measure)) for each in comparisons),
            ]
            for name in methods
        ],
        [line for each in comparisons for line in _data(each, [measure])],
        files_of(comparisons),
    )


def endings_table(comparisons: Sequence[Comparison]) -> Table:
    """How the episodes of each method ended, in numbers: with success, or with which failures."""
    kinds = {"success": "success", "collisions": COLLISION.name}
    kinds |= {key: one.name for key, one in FAILURES.items()}
    data: list[Mapping[str, object]] = []
    for one in comparisons:
        for method in one.methods:
            counts = {
                name: sum(is_number(row.get(metric)) and row[metric] > 0 for row in method.rows)
                for metric, name in kinds.items()
            }
            data.append({"cases": one.cases.title, "method": method.name, "of": len(method.rows), **counts})
    header = ["cases", "method", *(name for name in kinds.values() if any(row[name] for row in data)), "of"]
    return Table(
        "endings",
        "How episodes ended",
        "Numbers of episodes, of each agent; one with a collision may also have another ending.",
        header,
        [[Cell(str(row[name])) for name in header] for row in data],
        data,
        files_of(comparisons),
        heads=2,
    )


def _intervals(comparison: Comparison) -> str:
    """What the intervals are over, and from which tilt on ground counts as uneven."""
    if comparison.sites:
        over = f", over {comparison.sites} whole sites"
    else:
        over = ", over whole episodes" if any(method.agents > 1 for method in comparison.methods) else ""
    text = f"In brackets: 95 % intervals{over}."
    tilts = " or ".join(f"{one:g}°" for one in comparison.thresholds)
    return f"{text} VORT: ground is uneven above a tilt of {tilts}." if tilts else text


def _why_no_p(one: PairedComparison) -> str:
    if not math.isnan(one.p_value):
        return ""
    return "no pairs" if one.measure.per is None else "ratio by 0"


def _estimate(measure: Measure, method: str, estimates: Mapping[str, Mapping[str, Estimate]]) -> Cell:
    """The cell of a method, marked if it is the best one."""
    values = {name: found[measure.name].value for name, found in estimates.items() if measure.name in found}
    values = {name: value for name, value in values.items() if not math.isnan(value)}
    best = False
    if measure.better is not None and len(values) > 1 and method in values:
        shown = {name: format_value(measure, value) for name, value in values.items()}
        first = (max if measure.better == "higher" else min)(values, key=lambda name: values[name])
        # What reads the same is equally good; if all do, none is the best.
        best = shown[method] == shown[first] and len(set(shown.values())) > 1
    return estimate_cell(measure, estimates[method].get(measure.name), best=best)


def _data(comparison: Comparison, measures: Sequence[str]) -> list[Mapping[str, object]]:
    return [
        {
            "cases": comparison.cases.title,
            "method": method,
            "measure": name,
            "unit": "" if measure_of(name).unit == "%" else measure_of(name).unit,
            **{key: getattr(estimate, key) for key in ("value", "low", "high", "count")},
        }
        for method, found in comparison.estimates.items()
        for name, estimate in found.items()
        if name in measures
    ]
