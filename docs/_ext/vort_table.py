"""The table of experiments/vort: VORT at several thresholds, from the episodes of the study."""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import estimate_metrics

EPISODES = Path(__file__).parents[2] / "experiments" / "vort" / "episodes.csv"
# The measures of `metrics=vort` by threshold [deg]: the speed, and the time above it.
_MEASURES = {
    2: ("vort_2", "uneven_2"),
    5: ("VORT", "uneven"),
    10: ("vort_10", "uneven_10"),
    15: ("vort_15", "uneven_15"),
}
_CASE = ("set", "world", "world_seed", "episode")
_METRICS = ("vort", "vort_2", "vort_10", "vort_15", "uneven_time", "uneven_2", "uneven_10", "uneven_15")


def vort_table(episodes: Path = EPISODES) -> str:
    """For each threshold and policy VORT with its interval, in how many episodes, and the mean time."""
    with episodes.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    found = {policy: _estimate(row for row in rows if row["policy"] == policy) for policy in policies}
    head = ["threshold", *(f"{policy}: VORT [m/s]" for policy in policies)]
    head += [f"{policy}: episodes, mean time" for policy in policies]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for threshold, (speed, time) in _MEASURES.items():
        cells = [f"{threshold}°", *(_interval(found[policy][speed]) for policy in policies)]
        cells += [f"{found[policy][speed].count}, {found[policy][time].value:.1f} s" for policy in policies]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _estimate(rows: Iterable[Mapping[str, str]]) -> dict[str, Estimate]:
    plain: list[dict[str, Any]] = [
        {name: row[name] for name in _CASE} | {name: float(row[name]) for name in _METRICS} for row in rows
    ]
    return estimate_metrics(plain)


def _interval(estimate: Estimate) -> str:
    if estimate.value != estimate.value:
        return "-"
    if estimate.low != estimate.low:  # too few episodes for an interval
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} ({estimate.low:.2f} to {estimate.high:.2f})"
