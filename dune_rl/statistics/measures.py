"""Measures of evaluated episodes, with confidence intervals over independent sites or episodes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.metrics.catalogue import Measure, measures_of
from dune_rl.statistics.intervals import (
    Estimate,
    estimate_mean,
    estimate_proportion,
    estimate_ratio,
)

# The metrics of one agent in one episode, by name.
MetricsRow = dict[str, float]

# Columns that tell which site an episode is on, besides its number and its agent, where rows have them.
CASE_COLUMNS = ("set", "world", "seed", "world_seed")
# The column of a world's seed, where each episode draws one.
WORLD_SEED = "randomisation/world_seed"


def average_metrics(rows: Sequence[Mapping[str, float]]) -> MetricsRow:
    """The measures over `rows`, the return and the steps; NaN where no row has a value."""
    if not rows:
        return {}
    found = {measure.name: _value(measure, rows) for measure in measures_of(list(rows[0]))}
    return found | {name: _mean(column(rows, name)) for name in ("return", "steps")}


def mean_of_known(values: Iterable[float]) -> float:
    """The mean of the values that are not NaN; NaN without any."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def selection_score(statistics: Mapping[str, float]) -> float:
    """Score by which the best policy is selected: the success rate, or the return if there is none."""
    return statistics["SR"] if "SR" in statistics else statistics["return"]


def estimate_metrics(rows: Sequence[Mapping[str, Any]]) -> dict[str, Estimate]:
    """Each measure over `rows`, with its 95 % confidence interval.

    Shares have Wilson's interval; the rest are means over the episodes that have a value, with a studentised
    bootstrap: MTT over those that reached the goal, VORT over those that crossed uneven ground. Where an
    episode has several agents, or a site several episodes, intervals are over whole episodes or whole sites:
    see `cluster_rows`.
    """
    if not rows:
        return {}
    clusters, _ = cluster_rows(rows)
    found = {}
    for measure in measures_of(list(rows[0])):
        values, counts = column(rows, measure.metric), measure.are_counts
        if measure.per is not None:
            divisors = column(rows, measure.per)
            found[measure.name] = estimate_ratio(values, divisors, clusters, are_counts=counts)
        elif measure.is_share:
            found[measure.name] = estimate_proportion(values, clusters)
        else:
            found[measure.name] = estimate_mean(values, clusters, are_counts=counts)
    return found


def cluster_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[NDArray[np.int64] | None, str]:
    """The cluster of each row, from 0 on (None: rows are independent), and what the clusters are, in plural.

    Clusters are sites where several episodes share one: those with equal "set", "world" and "world_seed" (or
    "randomisation/world_seed"). Else they are episodes, if some have several agents. If all episodes are on
    one site, nothing can be said of other sites, and results hold for this one.
    """
    sites = _numbers([_site(row) for row in rows])
    episodes = _numbers(
        [
            (site, row.get("seed"), row.get("episode", index))
            for index, (site, row) in enumerate(zip(sites.tolist(), rows, strict=True))
        ]
    )
    num_sites, num_episodes = int(sites.max(initial=-1)) + 1, int(episodes.max(initial=-1)) + 1
    if 1 < num_sites < num_episodes:
        return sites, "sites"
    return (None, "episodes") if num_episodes == len(rows) else (episodes, "episodes")


def _site(row: Mapping[str, Any]) -> tuple[object, ...]:
    seed = row.get("world_seed", row.get(WORLD_SEED))
    # A world without a seed has an empty cell, which is read as NaN, unequal to itself.
    missing = seed is None or seed != seed
    return row.get("set"), row.get("world"), None if missing else seed


def _numbers(keys: Sequence[object]) -> NDArray[np.int64]:
    """A number for each of `keys`, from 0 on, the same for equal keys."""
    known: dict[object, int] = {}
    return np.array([known.setdefault(key, len(known)) for key in keys], np.int64)


def column(rows: Sequence[Mapping[str, Any]], name: str) -> Array:
    """The values (n,) of the metric `name`."""
    return np.array([row[name] for row in rows], float)


def _value(measure: Measure, rows: Sequence[Mapping[str, float]]) -> float:
    values = column(rows, measure.metric)
    if measure.per is None:
        return _mean(values)
    total = float(np.nansum(column(rows, measure.per)))
    return float(np.nansum(values)) / total if total else math.nan


def _mean(values: Array) -> float:
    seen = values[~np.isnan(values)]
    return float(seen.mean()) if len(seen) else math.nan
