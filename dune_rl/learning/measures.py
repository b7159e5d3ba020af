"""Statistics of evaluated episodes: means, confidence intervals, paired tests, and their CSV file."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import CheckpointError
from dune_rl.files import write_atomically
from dune_rl.learning.statistics import (
    Estimate,
    PairedTest,
    estimate_mean,
    estimate_proportion,
    estimate_ratio,
    mcnemar_test,
)
from dune_rl.metrics.catalogue import Measure, measures_of

# The metrics of one agent in one episode, by name.
MetricsRow = dict[str, float]


def average_metrics(rows: Sequence[Mapping[str, float]]) -> MetricsRow:
    """The measures over `rows`, the return and the steps; NaN where no row has a value."""
    if not rows:
        return {}
    found = {measure.name: _value(measure, rows) for measure in measures_of(list(rows[0]))}
    return found | {name: _mean(_column(rows, name)) for name in ("return", "steps")}


def selection_score(statistics: Mapping[str, float]) -> float:
    """Score by which the best policy is selected: the success rate, or the return if there is none."""
    return statistics["SR"] if "SR" in statistics else statistics["return"]


def estimate_metrics(rows: Sequence[Mapping[str, float]]) -> dict[str, Estimate]:
    """Each measure over `rows`, with its 95 % confidence interval.

    Shares have Wilson's interval; the rest are means over the episodes that have a value, with a studentised
    bootstrap: MTT over those that reached the goal, VORT over those that crossed uneven ground. Where an
    episode has several agents, whole episodes are resampled, as its agents are not independent.
    """
    if not rows:
        return {}
    episodes = _clusters(rows)
    found = {}
    for measure in measures_of(list(rows[0])):
        values = _column(rows, measure.metric)
        if measure.per is not None:
            found[measure.name] = estimate_ratio(values, _column(rows, measure.per), episodes)
        elif measure.is_share and episodes is None:
            found[measure.name] = estimate_proportion(values)
        else:
            found[measure.name] = estimate_mean(values, episodes)
    return found


def _clusters(rows: Sequence[Mapping[str, float]]) -> NDArray[np.int64] | None:
    """The episode of each row, if some have several agents."""
    ids = np.array([row.get("episode", index) for index, row in enumerate(rows)])
    unique, episodes = np.unique(ids, return_inverse=True)
    return None if len(unique) == len(rows) else episodes


def _column(rows: Sequence[Mapping[str, float]], name: str) -> NDArray[np.float64]:
    return np.array([row[name] for row in rows], float)


def _value(measure: Measure, rows: Sequence[Mapping[str, float]]) -> float:
    values = _column(rows, measure.metric)
    if measure.per is None:
        return _mean(values)
    total = float(np.nansum(_column(rows, measure.per)))
    return float(np.nansum(values)) / total if total else math.nan


def _mean(values: NDArray[np.float64]) -> float:
    seen = values[~np.isnan(values)]
    return float(seen.mean()) if len(seen) else math.nan


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
