"""Statistics of evaluated episodes: means, confidence intervals, paired tests, and their CSV file."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dune_rl.errors import CheckpointError
from dune_rl.files import write_atomically
from dune_rl.learning.statistics import Estimate, PairedTest, estimate_mean, estimate_proportion, mcnemar_test

# The metrics of one agent in one episode, by name.
MetricsRow = dict[str, float]

# Measures with meaning and unit: the paper's short names, and the battery's.
MEASURES: dict[str, tuple[str, str]] = {
    "SR": ("goal reached without collision", ""),
    "TR": ("goal reached", ""),
    "TC": ("collisions per episode", ""),
    "MTT": ("mean time to traverse", "s"),
    "OC": ("obstacle clearance", "m"),
    "VR": ("vertical roughness", "m/s²"),
    "VORT": ("velocity over rough terrain", "m/s"),
    "TSR": ("smoothness of route, less is smoother", ""),
    "energy": ("drawn from the battery", "W h"),
    "battery": ("share of a full one", ""),
    "range": ("with a full battery", "km"),
}
# Metric behind each measure.
_METRICS = {
    "SR": "success",
    "TR": "reached",
    "TC": "collisions",
    "MTT": "time_to_goal",
    "OC": "clearance",
    "VR": "vertical_roughness",
    "VORT": "vort",
    "TSR": "smoothness",
    "energy": "energy_wh",
    "battery": "battery_share",
    "range": "range_km",
}
_SHARES = ("SR", "TR")
# Columns that tables leave out: ids, what TensorBoard logs separately, and details.
_UNLISTED = {
    "agent", "episode", "steps", "return", "goals", "min_clearance",
    "diverged", "stuck", "flipped", "out_of_world", "timeout",
}  # fmt: skip


def measured_columns(names: Sequence[str]) -> dict[str, str]:
    """The measures that metrics of these `names` give, each with its metric.

    Those of `MEASURES` come first, by their short names; other metric terms follow by their own.
    """
    known = {measure: metric for measure, metric in _METRICS.items() if metric in names}
    taken = {*_METRICS.values(), *_UNLISTED}
    return known | {name: name for name in names if name not in taken and "/" not in name}


def average_metrics(rows: Sequence[Mapping[str, float]]) -> MetricsRow:
    """Means over `rows` of the measures, the return and the steps; NaN where no row has a value."""
    if not rows:
        return {}
    columns = {**measured_columns(list(rows[0])), "return": "return", "steps": "steps"}
    values = {name: np.array([row[column] for row in rows]) for name, column in columns.items()}
    return {
        name: float(column[~np.isnan(column)].mean()) if not np.isnan(column).all() else float("nan")
        for name, column in values.items()
    }


def selection_score(statistics: Mapping[str, float]) -> float:
    """Score by which the best policy is selected: the success rate, or the return if there is none."""
    return statistics["SR"] if "SR" in statistics else statistics["return"]


def estimate_metrics(rows: Sequence[Mapping[str, float]]) -> dict[str, Estimate]:
    """Each measure over `rows`, with its 95 % confidence interval.

    SR and TR are shares of episodes; the rest are means over the episodes
    that have a value: MTT over those that reached the goal, VORT over those
    that crossed uneven ground.
    """
    columns = measured_columns(list(rows[0])) if rows else {}
    return {
        name: (estimate_proportion if name in _SHARES else estimate_mean)([row[column] for row in rows])
        for name, column in columns.items()
    }


def compare_success(
    rows_a: Sequence[Mapping[str, float]], rows_b: Sequence[Mapping[str, float]]
) -> PairedTest:
    """Exact paired test of success between two evaluations; raises ValueError unless their episodes agree."""
    ids_a, ids_b = ([(row["episode"], row["agent"]) for row in rows] for rows in (rows_a, rows_b))
    if ids_a != ids_b:
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    return mcnemar_test([row["success"] > 0 for row in rows_a], [row["success"] > 0 for row in rows_b])


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write `rows` atomically, one line each, with the columns of the first; raises CheckpointError."""
    try:
        with write_atomically(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else [])
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be written: {error.strerror or error}.\nGive a folder that allows writing."
        ) from error
