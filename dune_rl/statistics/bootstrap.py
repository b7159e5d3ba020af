"""Intervals from resamples of the entries, the same at every call."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array

_RESAMPLES = 5_000
# Up to so many numbers are drawn once and kept; more are drawn in parts of at most so many.
_MOST_KEPT, _MOST_AT_A_TIME = 2**23, 2**20
# Relative errors below this are rounding: all entries are equal.
ROUNDING = 1e-9


def studentised_interval(above: Array, below: Array, confidence: float) -> tuple[float, float]:
    """The interval of sum(above) / sum(below), entries (n,), from resamples of both together.

    It is studentised (Efron & Tibshirani 1993, section 12.5); where too few entries differ for that, it is
    that of percentiles. Equal ratios give equal ends.
    """
    parts = (above, below, above**2, above * below, below**2)
    ratios, errors = _ratio_and_error(*_resampled_sums(*parts))
    ratio, error = _ratio_and_error(*(part.sum() for part in parts))
    with np.errstate(divide="ignore", invalid="ignore"):
        studentised = (ratios - ratio) / errors
    if error <= ROUNDING * abs(ratio):
        return float(ratio), float(ratio)
    tail = (1 - confidence) / 2
    usable = np.isfinite(studentised)
    if usable.mean() < 1 - tail:
        # Too few entries differ for that: a resample often has none of them, and no spread.
        low, high = np.quantile(ratios[np.isfinite(ratios)], [tail, 1 - tail])
    else:
        low, high = ratio - error * np.quantile(studentised[usable], [1 - tail, tail])
    return float(low), float(high)


@lru_cache(maxsize=2)
def _bootstrap_weights(count: int) -> Array:
    """How often each of `count` entries is drawn in each resample, (R, count)."""
    drawn = stream(0, "bootstrap", count).multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    return drawn.astype(float)


def _weight_parts(count: int) -> Iterator[Array]:
    """The same for some resamples at a time, (r, count); these take no more memory for more entries."""
    if count * _RESAMPLES <= _MOST_KEPT:
        yield _bootstrap_weights(count)
        return
    draws, rows = stream(0, "bootstrap in parts", count), max(1, _MOST_AT_A_TIME // count)
    for first in range(0, _RESAMPLES, rows):
        number = min(rows, _RESAMPLES - first)
        # Quicker than numbers of a multinomial distribution, where there are many.
        drawn = draws.integers(0, count, (number, count)) + count * np.arange(number)[:, None]
        yield np.bincount(drawn.ravel(), minlength=number * count).reshape(number, count).astype(float)


def _resampled_sums(*parts: Array) -> list[Array]:
    """The sum of each of `parts` (n,) in each resample, (R,)."""
    sums = [[weights @ part for part in parts] for weights in _weight_parts(len(parts[0]))]
    return [np.concatenate(each) for each in zip(*sums, strict=True)]


def _ratio_and_error(a: Any, b: Any, aa: Any, ab: Any, bb: Any) -> tuple[Any, Any]:
    """The ratio a / b of sums and its standard error to first order, up to a factor; arguments are sums."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = a / b
        # The sum of the squares of what is left of each numerator.
        residual = np.maximum(aa - 2 * ratio * ab + ratio**2 * bb, 0.0)
        return ratio, np.sqrt(residual) / np.abs(b)
