"""Confidence intervals for small numbers of episodes.

Episodes on one site have the site in common, and agents of one episode the episode. `clusters`, whole numbers
from 0 on, tell which entries belong together; intervals are then over clusters, and hold for new ones: for
new sites, not for further episodes on the same.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from dune_rl.geometry.arrays import Array
from dune_rl.statistics.resampling import ROUNDING, resampled_sums

CONFIDENCE = 0.95
# With fewer entries above 0 than this, and more that are 0, events are rare: a bootstrap covers too seldom.
_FEW_EVENTS = 10

_LEAST_UNITS = 2
# Of fewer a bootstrap sees too little: its intervals of 95 % cover 51 % of means of two, 82 % of three.
_LEAST_DRAWN = 4


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % interval; all NaN where nothing was measured.

    `count` entries have a value; they are of `units` independent ones: clusters, or the entries themselves.
    """

    value: float
    low: float
    high: float
    count: int
    units: int = 0


def as_shares(values: ArrayLike) -> Array:
    """Entries of 0 and 1, and shares between; what counts something is 1 where there is any of it."""
    return np.clip(np.asarray(values, float), 0.0, 1.0)


def estimate_proportion(successes: ArrayLike, clusters: ArrayLike | None = None) -> Estimate:
    """The share of true entries among those that are not NaN, with Wilson's interval.

    Entries between 0 and 1 are themselves shares: of several runs of one episode, which count as one, with
    the variance of entries of 0 and 1; the interval is then too wide rather than too narrow. It stays within
    [0, 1] and suits small n. With `clusters` it is the interval of n / d entries, by the quantile of
    Student's t for the number of clusters. The design effect d, at least 1, is the variance between clusters
    by that of independent entries (Korn & Graubard 1998; Dean & Pagano 2015 on Wilson's form of it).
    """
    seen = np.asarray(successes, float)
    present = ~np.isnan(seen)
    hits = as_shares(seen[present])
    clusters = None if clusters is None else np.asarray(clusters)[present]
    count, share = len(hits), float(hits.mean()) if len(hits) else np.nan
    if clusters is None:
        if not count:
            return Estimate(np.nan, np.nan, np.nan, 0)
        low, high = _wilson_ends(share, count, float(stats.norm.ppf(0.5 + CONFIDENCE / 2)))
        return Estimate(share, low, high, count, count)
    units = len(np.unique(clusters))
    if units < _LEAST_UNITS:
        return Estimate(share, np.nan, np.nan, count, units)
    effective = count / _design_effect(hits - share, share * (1 - share), clusters)
    low, high = _wilson_ends(share, effective, float(stats.t.ppf(0.5 + CONFIDENCE / 2, units - 1)))
    return Estimate(share, low, high, count, units)


def estimate_mean(
    values: ArrayLike, clusters: ArrayLike | None = None, *, are_counts: bool = False, signed: bool = False
) -> Estimate:
    """The mean of the entries that are not NaN, with a bootstrap interval; see `estimate_ratio`.

    Paired differences are `signed`: where few are not 0, the intervals of positive and negative ones are
    combined by MOVER (Zou & Donner 2008).
    """
    seen = np.asarray(values, float)
    present = ~np.isnan(seen)
    sums = np.where(present, seen, 0.0)
    estimate = estimate_ratio(sums, present, clusters, are_counts=are_counts, signed=signed)
    return replace(estimate, count=int(present.sum()))


def estimate_ratio(
    numerators: ArrayLike,
    denominators: ArrayLike,
    clusters: ArrayLike | None = None,
    *,
    are_counts: bool = False,
    signed: bool = False,
) -> Estimate:
    """The ratio of both sums, with a studentised bootstrap interval over the pairs.

    Entries are at least 0 unless `signed`. It assumes no distribution, and covers better than percentiles
    where many entries are 0, as collisions are (Efron & Tibshirani 1993, section 12.5). Clusters are drawn as
    a whole. Where fewer than ten numerators are above 0, and more are 0, the interval is that of a weighted
    sum of Poisson variables (Fay & Feuer 1997), as a bootstrap knows nothing of what was not seen. Without
    any event it reaches to 3.7 events in all, if numerators `are_counts` (the two-sided "rule of three",
    Hanley & Lippman-Hand 1983); else there is no upper end, and both are NaN. Entries of 0 and 0, and NaN,
    are left out. A bootstrap of fewer than four pairs, and anything of one, has an interval of NaN; equal
    ratios other than 0 have equal ends.
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
    if n < _LEAST_UNITS:
        return Estimate(value, np.nan, np.nan, count, n)
    signed = signed or bool(above.min() < 0.0)
    events = int(np.count_nonzero(above))
    if events < min(_FEW_EVENTS, n - events):
        low, high = _rare_event_interval(above / below.sum(), 1.0 / below.sum(), are_counts, signed=signed)
    elif n < _LEAST_DRAWN:
        low, high = np.nan, np.nan
    else:
        low, high = _studentised_interval(above, below)
        # A ratio of what is nowhere below 0 is not below 0 either.
        low = low if signed else max(low, 0.0)
    return Estimate(value, low, high, count, n)


def _studentised_interval(above: Array, below: Array) -> tuple[float, float]:
    """The interval of sum(above) / sum(below), entries (n,), from resamples of both together.

    It is studentised (Efron & Tibshirani 1993, section 12.5); where too few entries differ for that, it is
    that of percentiles. Equal ratios give equal ends.
    """
    parts = (above, below, above**2, above * below, below**2)
    ratios, errors = _ratio_and_error(*resampled_sums(*parts))
    ratio, error = _ratio_and_error(*(part.sum() for part in parts))
    with np.errstate(divide="ignore", invalid="ignore"):
        studentised = (ratios - ratio) / errors
    if error <= ROUNDING * abs(ratio):
        return float(ratio), float(ratio)
    tail = (1 - CONFIDENCE) / 2
    usable = np.isfinite(studentised)
    if usable.mean() < 1 - tail:
        # Too few entries differ for that: a resample often has none of them, and no spread.
        low, high = np.quantile(ratios[np.isfinite(ratios)], [tail, 1 - tail])
    else:
        low, high = ratio - error * np.quantile(studentised[usable], [1 - tail, tail])
    return float(low), float(high)


def _ratio_and_error(a: Any, b: Any, aa: Any, ab: Any, bb: Any) -> tuple[Any, Any]:
    """The ratio a / b of sums and its standard error to first order, up to a factor; arguments are sums."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = a / b
        # The sum of the squares of what is left of each numerator.
        residual = np.maximum(aa - 2 * ratio * ab + ratio**2 * bb, 0.0)
        return ratio, np.sqrt(residual) / np.abs(b)


def _design_effect(residuals: Array, variance: float, clusters: ArrayLike) -> float:
    """Variance of a mean over `clusters`, by that of independent entries of this `variance`; at least 1."""
    sums = np.bincount(np.unique(np.asarray(clusters), return_inverse=True)[1], residuals)
    independent = variance * len(residuals)
    if independent <= ROUNDING:
        return 1.0
    return max(1.0, float((sums**2).sum()) * len(sums) / (len(sums) - 1) / independent)


def _wilson_ends(share: float, count: float, quantile: float) -> tuple[float, float]:
    """Wilson's interval for a share of `count` entries, which need not be whole (Wilson 1927)."""
    square = quantile**2 / count
    centre = (share + square / 2) / (1 + square)
    half = quantile / (1 + square) * np.sqrt(share * (1 - share) / count + square / (4 * count))
    # Exact where rounding would miss it.
    low = 0.0 if share == 0.0 else max(0.0, float(centre - half))
    return low, 1.0 if share == 1.0 else min(1.0, float(centre + half))


def _rare_event_interval(
    parts: Array, least: float, are_counts: bool, *, signed: bool
) -> tuple[float, float]:
    """Interval of the sum of `parts`, each other than 0 a Poisson event of that weight."""
    heaviest = float(np.abs(parts).max())
    if not heaviest:
        if not are_counts:
            return np.nan, np.nan
        heaviest = least
    plus, low, high = _gamma_interval(parts[parts > 0.0], heaviest)
    if not signed:
        return low, high
    minus, least_minus, most_minus = _gamma_interval(-parts[parts < 0.0], heaviest)
    return (
        plus - minus - math.hypot(plus - low, most_minus - minus),
        plus - minus + math.hypot(high - plus, minus - least_minus),
    )


def _gamma_interval(weights: Array, heaviest: float) -> tuple[float, float, float]:
    """Sum of the weights of Poisson events, and the ends of its gamma interval (Fay & Feuer 1997).

    The upper end allows for one more event of the weight `heaviest`.
    """
    tail = (1 - CONFIDENCE) / 2
    value, variance = float(weights.sum()), float((weights**2).sum())
    low = variance / value / 2 * stats.chi2.ppf(tail, 2 * value**2 / variance) if value else 0.0
    more, spread = value + heaviest, variance + heaviest**2
    high = spread / more / 2 * stats.chi2.ppf(1 - tail, 2 * more**2 / spread)
    return value, float(low), float(high)


def estimate_share_difference(a: ArrayLike, b: ArrayLike, clusters: ArrayLike | None = None) -> Estimate:
    """The share of true entries of `a` less that of `b`, paired, with an adjusted Wald interval.

    One discordant pair is added for each side (Bonett & Price 2012), so that a few or none of them give an
    interval too; entries may be shares, as for `estimate_proportion`. With `clusters`, the number of pairs is
    divided by the design effect, as for `estimate_proportion`.
    """
    difference = as_shares(a) - as_shares(b)
    count = len(difference)
    if not count:
        return Estimate(np.nan, np.nan, np.nan, 0)
    value = float(difference.mean())
    units, effective, quantile = count, float(count), float(stats.norm.ppf(0.5 + CONFIDENCE / 2))
    if clusters is not None:
        units = len(np.unique(np.asarray(clusters)))
        if units < _LEAST_UNITS:
            return Estimate(value, np.nan, np.nan, count, units)
        effective /= _design_effect(difference - value, float(difference.var()), clusters)
        quantile = float(stats.t.ppf(0.5 + CONFIDENCE / 2, units - 1))
    centre = value * effective / (effective + 2)
    discordant = (float((difference**2).mean()) * effective + 2) / (effective + 2)
    half = quantile * np.sqrt((discordant - centre**2) / (effective + 2))
    return Estimate(value, max(-1.0, float(centre - half)), min(1.0, float(centre + half)), count, units)


def estimate_ratio_difference(
    first: tuple[ArrayLike, ArrayLike], second: tuple[ArrayLike, ArrayLike], clusters: ArrayLike | None = None
) -> Estimate:
    """The ratio of the sums of `first`, numerators and denominators, less that of `second`, in pairs.

    The interval is Student's, of the ratios' linear parts, whose errors cancel where they are paired (Cochran
    1977, section 6.3).
    """
    parts = [sum_by_cluster(np.asarray(values, float), clusters) for values in (*first, *second)]
    used = np.any([part != 0.0 for part in parts], axis=0)
    (a, b), (c, d) = (parts[0][used], parts[1][used]), (parts[2][used], parts[3][used])
    count, units = len(np.asarray(first[0])), int(used.sum())
    if not b.sum() or not d.sum():
        return Estimate(np.nan, np.nan, np.nan, count, units)
    ratios = a.sum() / b.sum(), c.sum() / d.sum()
    value = float(ratios[0] - ratios[1])
    if units < _LEAST_UNITS:
        return Estimate(value, np.nan, np.nan, count, units)
    linear = (a - ratios[0] * b) / b.sum() - (c - ratios[1] * d) / d.sum()
    error = math.sqrt(units / (units - 1) * float((linear**2).sum()))
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, units - 1)) * error
    return Estimate(value, value - half, value + half, count, units)


def sum_by_cluster(values: Array, clusters: ArrayLike | None) -> Array:
    """The sums over clusters of what is not NaN; without clusters the values."""
    present = np.nan_to_num(values)
    if clusters is None:
        return present
    return np.bincount(np.asarray(clusters, np.int64), present).astype(np.float64)
