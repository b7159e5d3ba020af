"""Tests of two policies on the same episodes.

`clusters`, whole numbers from 0 on, tell which pairs belong together, such as those on one site: tests then
exchange whole clusters, and hold for new ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.statistics.bootstrap import ROUNDING
from dune_rl.statistics.intervals import sum_by_cluster

_PERMUTATIONS = 9_999
_EXACT_UP_TO = 13
# Up to so many signs are drawn once and kept; more are drawn in parts of at most so many.
_MOST_KEPT, _MOST_AT_A_TIME = 2**23, 2**20
_LEAST_UNITS = 2


@dataclass(frozen=True)
class PairedTest:
    """Two policies on the same episodes: how many only one of them solved, and the p-value of a test."""

    only_a: int
    only_b: int
    p_value: float


def mcnemar_test(a: ArrayLike, b: ArrayLike, clusters: ArrayLike | None = None) -> PairedTest:
    """Exact two-sided McNemar test of two boolean arrays with paired entries.

    With `clusters` it is the sign-flip test of the differences instead, as McNemar's takes pairs for
    independent.
    """
    first, second = np.asarray(a, bool), np.asarray(b, bool)
    only_a, only_b = int((first & ~second).sum()), int((~first & second).sum())
    if clusters is not None:
        difference = first.astype(float) - second
        return PairedTest(only_a, only_b, sign_flip_test(difference, clusters))
    p_value = stats.binomtest(only_a, only_a + only_b).pvalue if only_a + only_b else 1.0
    return PairedTest(only_a, only_b, float(p_value))


def sign_flip_test(differences: ArrayLike, clusters: ArrayLike | None = None) -> float:
    """p-value of the two-sided permutation test that the mean of paired `differences` is 0; NaN without any.

    Which of both is first is exchanged for each entry, or for each cluster as a whole; the statistic is the
    sum. It is exact for up to 13 entries or clusters that are not 0, and of 9,999 random exchanges beyond.
    """
    values = np.asarray(differences, float)
    if not len(values):
        return float("nan")
    sums = sum_by_cluster(values, clusters)
    # A sum whose sign makes no difference has no part in it; rounding must not make one.
    sums = sums[np.abs(sums) > ROUNDING * np.abs(values).sum()]
    if len(sums) < _LEAST_UNITS:
        return 1.0
    return _p_value(sums.sum(), *_exchanged_sums(sums))


def ratio_exchange_test(
    first: tuple[ArrayLike, ArrayLike], second: tuple[ArrayLike, ArrayLike], clusters: ArrayLike | None = None
) -> float:
    """p-value of the two-sided permutation test that two ratios of sums are equal; NaN if one is unknown.

    Arguments are as for `estimate_ratio_difference`; exchanges as in `sign_flip_test`.
    """
    a, b, c, d = (sum_by_cluster(np.asarray(values, float), clusters) for values in (*first, *second))
    differ = (a != c) | (b != d)
    if not b.sum() or not d.sum():
        return float("nan")
    if differ.sum() < _LEAST_UNITS:
        return 1.0
    above, below = (a + c).sum(), (b + d).sum()
    # What of the sums goes to the first, less what goes to the second.
    more, longer = _exchanged_sums((a - c)[differ], (b - d)[differ])
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (above + more) / (below + longer) - (above - more) / (below - longer)
    # Without a denominator on one side, the ratios are as far apart as can be.
    return _p_value(float(a.sum() / b.sum() - c.sum() / d.sum()), np.nan_to_num(found, nan=np.inf))


@lru_cache(maxsize=2)
def _signs(count: int) -> Array:
    """Signs (R, count): all that there are, or random ones."""
    if count <= _EXACT_UP_TO:
        return np.asarray(1.0 - 2.0 * (np.arange(2**count)[:, None] >> np.arange(count) & 1), np.float64)
    return np.concatenate(list(_random_signs(count, _PERMUTATIONS)))


def _random_signs(count: int, rows: int) -> Iterator[Array]:
    """Random signs, at most `rows` exchanges at a time, (r, count); they are the same whatever `rows` is."""
    draws = stream(0, "permutation", count)
    # The observed signs are one of the permutations.
    yield np.ones((1, count))
    for first in range(0, _PERMUTATIONS, rows):
        shape = (min(rows, _PERMUTATIONS - first), count)
        yield 1.0 - 2.0 * draws.integers(0, 2, shape, np.int8)


def _sign_parts(count: int) -> Iterator[Array]:
    """Signs for some exchanges at a time; these take no more memory for more entries."""
    if count <= _EXACT_UP_TO or count * _PERMUTATIONS <= _MOST_KEPT:
        yield _signs(count)
        return
    # NumPy draws four numbers of 8 bits at a time, and forgets the rest of them at the end of a call.
    yield from _random_signs(count, max(4, _MOST_AT_A_TIME // count // 4 * 4))


def _exchanged_sums(*parts: Array) -> list[Array]:
    """The sum of each of `parts` (n,) in each exchange, (R,)."""
    sums = [[signs @ part for part in parts] for signs in _sign_parts(len(parts[0]))]
    return [np.concatenate(each) for each in zip(*sums, strict=True)]


def _p_value(observed: float, permuted: Array) -> float:
    """The share of `permuted` values at least as far from 0 as the one `observed`, which is among them."""
    return float(np.mean(np.abs(permuted) >= abs(observed) * (1 - ROUNDING)))
