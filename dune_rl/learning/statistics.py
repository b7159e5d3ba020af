"""Confidence intervals and paired tests for small numbers of episodes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from dune_rl.seeding import stream

CONFIDENCE = 0.95
_RESAMPLES = 5_000


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % interval; all NaN where nothing was measured."""

    value: float
    low: float
    high: float
    count: int


def estimate_proportion(successes: ArrayLike) -> Estimate:
    """The share of true entries, with Wilson's interval, which stays within [0, 1] and suits small n."""
    hits = np.asarray(successes, bool)
    if not len(hits):
        return Estimate(np.nan, np.nan, np.nan, 0)
    interval = stats.binomtest(int(hits.sum()), len(hits)).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(float(hits.mean()), float(interval.low), float(interval.high), len(hits))


def estimate_mean(values: ArrayLike) -> Estimate:
    """The mean of the entries that are not NaN, with a percentile bootstrap interval.

    It assumes no distribution: collisions, for one, are mostly zero. One
    entry gives an interval of NaN. Equal entries give equal intervals.
    """
    seen = np.asarray(values, float)
    seen = seen[~np.isnan(seen)]
    n = len(seen)
    if n < 2:
        return Estimate(float(seen[0]) if n else np.nan, np.nan, np.nan, n)
    weights = stream(0, "bootstrap", n).multinomial(n, np.full(n, 1 / n), size=_RESAMPLES)
    low, high = np.quantile(weights @ seen / n, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(seen.mean()), float(low), float(high), n)


@dataclass(frozen=True)
class PairedTest:
    """Two policies on the same episodes: how many only one of them solved, and the exact McNemar p-value."""

    only_a: int
    only_b: int
    p_value: float


def mcnemar_test(a: ArrayLike, b: ArrayLike) -> PairedTest:
    """Exact two-sided McNemar test of two boolean arrays with paired entries."""
    first, second = np.asarray(a, bool), np.asarray(b, bool)
    only_a, only_b = int((first & ~second).sum()), int((~first & second).sum())
    p_value = stats.binomtest(only_a, only_a + only_b).pvalue if only_a + only_b else 1.0
    return PairedTest(only_a, only_b, float(p_value))
