"""Confidence intervals and paired tests for small numbers of episodes."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from dune_rl.seeding import stream

CONFIDENCE = 0.95
_RESAMPLES = 5_000
# Relative errors below this are rounding: all entries are equal.
_ROUNDING = 1e-9

Array = NDArray[np.float64]


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


def estimate_mean(values: ArrayLike, clusters: ArrayLike | None = None) -> Estimate:
    """The mean of the entries that are not NaN, with a bootstrap interval; see `estimate_ratio`."""
    seen = np.asarray(values, float)
    present = ~np.isnan(seen)
    estimate = estimate_ratio(np.where(present, seen, 0.0), present, clusters)
    return replace(estimate, count=int(present.sum()))


def estimate_ratio(
    numerators: ArrayLike, denominators: ArrayLike, clusters: ArrayLike | None = None
) -> Estimate:
    """The ratio of both sums, with a studentised bootstrap interval over the pairs.

    It assumes no distribution, and covers better than percentiles where most entries are 0, as collisions are
    (Efron & Tibshirani 1993, section 12.5). With `clusters`, whole numbers from 0 on, pairs of equal numbers
    are drawn together, as they need not be independent. Entries of 0 and 0, and of NaN, have no share in it.
    One pair gives an interval of NaN; equal ratios give equal ends.
    """
    above, below = (np.nan_to_num(np.asarray(values, float)) for values in (numerators, denominators))
    count = len(above)
    if clusters is not None:
        numbers = np.asarray(clusters, np.int64)
        above, below = (np.bincount(numbers, values) for values in (above, below))
    used = (above != 0.0) | (below != 0.0)
    above, below = above[used], below[used]
    if not below.sum():
        return Estimate(np.nan, np.nan, np.nan, count)
    value, n = float(above.sum() / below.sum()), len(above)
    if n < 2:
        return Estimate(value, np.nan, np.nan, count)
    low, high = _studentised_interval(above, below, _bootstrap_weights(n))
    return Estimate(value, low, high, count)


@lru_cache(maxsize=4)
def _bootstrap_weights(count: int) -> Array:
    """How often each of `count` entries is drawn in each resample, (R, count)."""
    drawn = stream(0, "bootstrap", count).multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    return drawn.astype(float)


def _studentised_interval(above: Array, below: Array, weights: Array) -> tuple[float, float]:
    """The interval of sum(above) / sum(below), entries (n,), from the weights (R, n) of its resamples."""
    sums = {"a": weights @ above, "b": weights @ below}
    squares = {"aa": weights @ above**2, "ab": weights @ (above * below), "bb": weights @ below**2}
    ratios, errors = _ratio_and_error(**sums, **squares)
    ratio, error = _ratio_and_error(
        above.sum(), below.sum(), (above**2).sum(), (above * below).sum(), (below**2).sum()
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        studentised = (ratios - ratio) / errors
    if error <= _ROUNDING * abs(ratio):
        return float(ratio), float(ratio)
    tail = (1 - CONFIDENCE) / 2
    usable = np.isfinite(studentised)
    if usable.mean() < 1 - tail:
        # Too few entries differ for that: a resample often has none of them, and no spread.
        low, high = np.quantile(ratios[np.isfinite(ratios)], [tail, 1 - tail])
    else:
        low, high = ratio - error * np.quantile(studentised[usable], [1 - tail, tail])
    # A ratio of what is nowhere below 0 is not below 0 either.
    least = 0.0 if above.min() >= 0.0 and below.min() >= 0.0 else -np.inf
    return float(max(low, least)), float(high)


def _ratio_and_error(a: Any, b: Any, aa: Any, ab: Any, bb: Any) -> tuple[Any, Any]:
    """The ratio a / b of sums and its standard error to first order, up to a factor; arguments are sums."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = a / b
        # The sum of the squares of what is left of each numerator.
        residual = np.maximum(aa - 2 * ratio * ab + ratio**2 * bb, 0.0)
        return ratio, np.sqrt(residual) / np.abs(b)


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
