"""Aggregates over several cases and runs, after Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge
of the Statistical Precipice": interquartile mean, median, mean, optimality gap, performance profiles, and the
probability of improvement.

A method has a score for each of its units in each set of cases (the paper's task). Units are its runs (seeds
of its training) or, where methods have one run each, the sites of the cases: these are what is independent.
Intervals are those of 95 % of the percentile bootstrap, stratified: units are drawn anew within each set.
All cases weigh the same, however many units they have. The values are those of the authors' library rliable,
which is not used as it needs pandas, seaborn and arch besides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.statistics.intervals import CONFIDENCE, Estimate
from dune_rl.statistics.resampling import times_drawn

# The row of an episode.
Row = Mapping[str, Any]
# The scores of a method: for each set of cases those of its units, (U,) each.
Scores = Mapping[str, Array]
RESAMPLES = 2_000
_TAIL = (1 - CONFIDENCE) / 2


@dataclass(frozen=True)
class Profile:
    """The share of units with a score above each of `thresholds` (T,), and the ends of its interval."""

    thresholds: Array
    share: Array
    low: Array
    high: Array


def site_scores(rows: Sequence[Row], metric: str) -> Array:
    """The mean of `metric` on each site of the rows, (U,), by the world's seed: without one, of each episode.

    Episodes in which the metric has no value are left out.
    """
    sums: dict[tuple[str, float], list[float]] = {}
    for row in rows:
        value, seed = row.get(metric, np.nan), row.get("world_seed", np.nan)
        if isinstance(value, int | float) and np.isfinite(value):
            known = isinstance(seed, int | float) and np.isfinite(seed)
            key = ("site", float(seed)) if known else ("episode", float(row["episode"]))
            sums.setdefault(key, []).append(float(value))
    return np.array([np.mean(values) for values in sums.values()])


def run_scores(runs: Sequence[Sequence[Row]], metric: str) -> Array:
    """The mean of `metric` of each run, (U,), from its rows; runs without a value are left out."""
    means = []
    for rows in runs:
        values = np.array([row.get(metric, np.nan) for row in rows], float)
        if np.isfinite(values).any():
            means.append(float(np.nanmean(values)))
    return np.array(means)


def interquartile_mean(scores: Array, weights: Array) -> Array:
    """The mean of the middle half of `scores` (..., N), where each weighs as in `weights`, of the same shape.

    A score that a quartile cuts counts in part, so that the weight that counts is exactly a half.
    """
    order = np.argsort(scores, axis=-1, kind="stable")
    ordered = np.take_along_axis(scores, order, -1)
    share = np.take_along_axis(weights, order, -1)
    upto = np.cumsum(share, axis=-1) / share.sum(axis=-1, keepdims=True)
    below = np.concatenate([np.zeros_like(upto[..., :1]), upto[..., :-1]], axis=-1)
    inside = np.clip(upto, 0.25, 0.75) - np.clip(below, 0.25, 0.75)
    found: Array = (ordered * inside).sum(axis=-1) / inside.sum(axis=-1)
    return found


def aggregate_scores(scores: Scores) -> dict[str, Estimate]:
    """IQM, median, mean and optimality gap of a method, each with its interval.

    The median is that of the means of the cases, the mean their mean, and the gap is how far scores stay
    below 1 on average. The count is that of all units. Cases without scores are left out.
    """
    kept = {cases: values for cases, values in scores.items() if len(values)}
    if not kept:
        nothing = Estimate(np.nan, np.nan, np.nan, 0)
        return {name: nothing for name in ("IQM", "median", "mean", "optimality gap")}
    own = _measures({cases: values[None] for cases, values in kept.items()})
    resampled = _measures(
        {cases: values[drawn] for (cases, values), drawn in zip(kept.items(), _draws(kept), strict=True)}
    )
    count = sum(len(values) for values in kept.values())
    return {name: Estimate(float(own[name][0]), *_ends(found), count) for name, found in resampled.items()}


def _measures(scores: dict[str, Array]) -> dict[str, Array]:
    """The aggregates, (R,) each, of resampled scores (R, U) of each set of cases."""
    pooled = np.concatenate(list(scores.values()), axis=1)
    weights = [np.full(values.shape, 1.0 / values.shape[1]) for values in scores.values()]
    means = np.stack([values.mean(axis=1) for values in scores.values()], axis=1)
    capped = np.stack([np.minimum(values, 1.0).mean(axis=1) for values in scores.values()], axis=1)
    return {
        "IQM": interquartile_mean(pooled, np.concatenate(weights, axis=1)),
        "median": np.median(means, axis=1),
        "mean": means.mean(axis=1),
        "optimality gap": 1.0 - capped.mean(axis=1),
    }


def performance_profile(scores: Scores, thresholds: Array) -> Profile:
    """The share of a method's units with scores above `thresholds` (T,), averaged over the cases."""
    kept = {cases: values for cases, values in scores.items() if len(values)}
    if not kept:
        nothing = np.full(len(thresholds), np.nan)
        return Profile(thresholds, nothing, nothing, nothing)
    shares, resampled = [], []
    for values, drawn in zip(kept.values(), _draws(kept), strict=True):
        above = (values[:, None] > thresholds).astype(float)
        # How often each unit is drawn, (R, U).
        times = times_drawn(drawn, len(values))
        shares.append(above.mean(axis=0))
        resampled.append(times @ above / len(values))
    low, high = np.quantile(np.mean(resampled, axis=0), [_TAIL, 1 - _TAIL], axis=0)
    return Profile(thresholds, np.mean(shares, axis=0), low, high)


def probability_of_improvement(first: Scores, second: Scores) -> Estimate:
    """How probably a unit of `first` has a higher score than one of `second`, averaged over their cases.

    Ties count half. All pairs of units of the same cases are compared (Mann-Whitney), whether or not they are
    of the same site. The count is that of the cases which both have.
    """
    shared = [cases for cases in first if len(first[cases]) and len(second.get(cases, ()))]
    if not shared:
        return Estimate(np.nan, np.nan, np.nan, 0)
    values, resampled = [], []
    for number, cases in enumerate(shared):
        a, b = first[cases], second[cases]
        wins = (a[:, None] > b) + 0.5 * (a[:, None] == b)
        times_a = times_drawn(_drawn_units(len(a), number, 0), len(a))
        times_b = times_drawn(_drawn_units(len(b), number, 1), len(b))
        values.append(wins.mean())
        resampled.append(np.einsum("ra,ab,rb->r", times_a, wins, times_b, optimize=True) / wins.size)
    return Estimate(float(np.mean(values)), *_ends(np.mean(resampled, axis=0)), len(shared))


def _draws(scores: Scores) -> list[NDArray[np.int64]]:
    return [_drawn_units(len(values), number, 0) for number, values in enumerate(scores.values())]


def _drawn_units(count: int, cases: int, method: int) -> NDArray[np.int64]:
    """The numbers of the units of each resample, (R, count): the same at every call."""
    return stream(0, "bootstrap of units", count, cases, method).integers(0, count, (RESAMPLES, count))


def _ends(resampled: Array) -> tuple[float, float]:
    low, high = np.quantile(resampled, [_TAIL, 1 - _TAIL])
    return float(low), float(high)
