"""The table of experiments/vort: VORT at several thresholds, from the study's own file."""

import csv
from pathlib import Path

SUMMARY = Path(__file__).parents[2] / "experiments" / "vort" / "summary.csv"
# The measures of `metrics=vort` by threshold [deg]: the speed, and the time above it.
_MEASURES = {
    2: ("vort_2", "uneven_2"),
    5: ("VORT", "uneven"),
    10: ("vort_10", "uneven_10"),
    15: ("vort_15", "uneven_15"),
}


def vort_table(summary: Path = SUMMARY) -> str:
    """For each threshold and policy VORT with its interval, in how many episodes, and for how long."""
    with summary.open(newline="", encoding="utf-8") as file:
        rows = {(row["policy"], row["measure"]): row for row in csv.DictReader(file)}
    policies = list(dict.fromkeys(policy for policy, _ in rows))
    head = ["threshold", *(f"{policy}: VORT [m/s]" for policy in policies)]
    head += [f"{policy}: episodes, time above" for policy in policies]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for threshold, (speed, time) in _MEASURES.items():
        cells = [f"{threshold}°", *(_interval(rows[policy, speed]) for policy in policies)]
        cells += [
            f"{rows[policy, speed]['count']}, {float(rows[policy, time]['value']):.1f} s"
            for policy in policies
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _interval(row: dict[str, str]) -> str:
    value, low, high = (float(row[name]) for name in ("value", "low", "high"))
    return f"{value:.2f} ({low:.2f} to {high:.2f})"
