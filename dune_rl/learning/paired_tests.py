"""Tests of two policies on the same episodes.

`clusters`, whole numbers from 0 on, tell which pairs belong together, such as those on one site: tests then
exchange whole clusters, and hold for new ones.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from dune_rl.learning.statistics import sum_by_cluster
from dune_rl.seeding import stream

Array = NDArray[np.float64]

_PERMUTATIONS = 9_999
_EXACT_UP_TO = 13
_LEAST_UNITS = 2
# Relative differences below this are rounding.
_ROUNDING = 1e-9


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
    sums = sums[np.abs(sums) > _ROUNDING * np.abs(values).sum()]
    if len(sums) < _LEAST_UNITS:
        return 1.0
    return _p_value(sums.sum(), _signs(len(sums)) @ sums)


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
    signs = _signs(int(differ.sum()))
    above, below = (a + c).sum(), (b + d).sum()
    # What of the sums goes to the first, less what goes to the second.
    more, longer = signs @ (a - c)[differ], signs @ (b - d)[differ]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (above + more) / (below + longer) - (above - more) / (below - longer)
    # Without a denominator on one side, the ratios are as far apart as can be.
    return _p_value(float(a.sum() / b.sum() - c.sum() / d.sum()), np.nan_to_num(found, nan=np.inf))


@lru_cache(maxsize=2)
def _signs(count: int) -> Array:
    """Signs (R, count): all that there are, or random ones."""
    if count <= _EXACT_UP_TO:
        return np.asarray(1.0 - 2.0 * (np.arange(2**count)[:, None] >> np.arange(count) & 1), np.float64)
    drawn = stream(0, "permutation", count).integers(0, 2, (_PERMUTATIONS, count), np.int8)
    # The observed signs are one of the permutations.
    return np.concatenate([np.ones((1, count)), 1.0 - 2.0 * drawn])


def _p_value(observed: float, permuted: Array) -> float:
    """The share of `permuted` values at least as far from 0 as the one `observed`, which is among them."""
    return float(np.mean(np.abs(permuted) >= abs(observed) * (1 - _ROUNDING)))
