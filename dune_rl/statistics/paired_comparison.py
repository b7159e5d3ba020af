"""Paired tests and comparisons of policies on the same episodes.

`clusters`, whole numbers from 0 on, tell which pairs belong together, such as pairs on one site: tests then
exchange whole clusters, and hold for new clusters.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from dune_rl.geometry.arrays import Array
from dune_rl.metrics.catalogue import Measure, measures_of
from dune_rl.statistics.intervals import (
    Estimate,
    as_shares,
    estimate_mean,
    estimate_ratio_difference,
    estimate_share_difference,
    sum_by_cluster,
)
from dune_rl.statistics.measures import CASE_COLUMNS, cluster_rows, column
from dune_rl.statistics.resampling import LEAST_P, ROUNDING, exchanged_sums

Rows = Sequence[Mapping[str, Any]]

_LEAST_UNITS = 2
# What tells the cases of two evaluations apart, where rows have it.
_CASE = (*CASE_COLUMNS, "episode", "agent")


@dataclass(frozen=True)
class PairedTest:
    """Two policies on the same episodes: how many only one of them solved, and the p-value of a test."""

    only_a: int
    only_b: int
    p_value: float

    @property
    def p_is_bound(self) -> bool:
        """Whether random exchanges tell only that the p-value is at most this."""
        return _is_least(self.p_value)


def _is_least(p_value: float) -> bool:
    # Exact tests have multiples of powers of 1/2, which are never this.
    return math.isclose(p_value, LEAST_P, rel_tol=1e-9)


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
    return _p_value(sums.sum(), *exchanged_sums(sums))


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
    more, longer = exchanged_sums((a - c)[differ], (b - d)[differ])
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (above + more) / (below + longer) - (above - more) / (below - longer)
    # Without a denominator on one side, the ratios are as far apart as can be.
    return _p_value(float(a.sum() / b.sum() - c.sum() / d.sum()), np.nan_to_num(found, nan=np.inf))


def _p_value(observed: float, permuted: Array) -> float:
    """The share of `permuted` values at least as far from 0 as the one `observed`, which is among them."""
    return float(np.mean(np.abs(permuted) >= abs(observed) * (1 - ROUNDING)))


def compare_success(rows_a: Sequence[Mapping[str, Any]], rows_b: Sequence[Mapping[str, Any]]) -> PairedTest:
    """Paired test of success between two evaluations; raises ValueError unless their episodes agree.

    It is McNemar's exact one, or the sign-flip test where rows are not independent: see `cluster_rows`.
    """
    ids_a, ids_b = ([(row["episode"], row["agent"]) for row in rows] for rows in (rows_a, rows_b))
    if ids_a != ids_b:
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    a, b = ([row["success"] > 0 for row in rows] for rows in (rows_a, rows_b))
    return mcnemar_test(a, b, cluster_rows(rows_a)[0])


@dataclass(frozen=True)
class PairedComparison:
    """One measure of two policies on the same episodes.

    `difference` is `first` minus `second`, with a 95 % interval; of means over the episodes in which both
    have a value. `p_value` is of the exact McNemar test for shares, and of a permutation test for the rest.
    Where a site has several episodes, an episode several agents, or a share is the mean of several runs of an
    episode, shares have a permutation test too; of sites or episodes as a whole (`cluster_rows`).
    `adjusted_p` is the same by Holm's method over all pairs of policies, for this measure alone. `effect` is
    the share of discordant pairs that `first` wins for shares (0.5: none), the quotient of both for ratios of
    sums (1: none), and for means, also of several runs, Cohen's d of paired samples (mean over standard
    deviation of the differences; 0: none).
    """

    measure: Measure
    first: str
    second: str
    difference: Estimate
    p_value: float
    effect: float
    adjusted_p: float = np.nan

    @property
    def p_is_bound(self) -> bool:
        """Whether random exchanges tell only that both p-values are at most these."""
        return _is_least(self.p_value)


def compare_policies(results: Mapping[str, Rows]) -> list[PairedComparison]:
    """All measures of all pairs of policies, by measure; raises ValueError if their episodes differ."""
    if len(results) < 2:
        return []
    # Metrics that only some policies have are in no comparison.
    names = [
        name for name in next(iter(results.values()))[0] if all(name in rows[0] for rows in results.values())
    ]
    found: list[PairedComparison] = []
    for measure in measures_of(names):
        pairs = [
            _compare(measure, (first, results[first]), (second, results[second]))
            for first, second in combinations(results, 2)
        ]
        adjusted = holm_adjusted([pair.p_value for pair in pairs])
        found += [replace(pair, adjusted_p=p) for pair, p in zip(pairs, adjusted, strict=True)]
    return found


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted by Holm's step-down method (Holm 1979), in the same order; NaN is no test."""
    values = np.asarray(p_values, float)
    tested = np.flatnonzero(~np.isnan(values))
    order = tested[np.argsort(values[tested], kind="stable")]
    steps = values[order] * np.arange(len(order), 0, -1)
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted.tolist()


def _compare(measure: Measure, first: tuple[str, Rows], second: tuple[str, Rows]) -> PairedComparison:
    if not have_same_cases(first[1], second[1]):
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    clusters, _ = cluster_rows(first[1])
    a, b = (column(rows, measure.metric) for rows in (first[1], second[1]))
    if measure.per is not None:
        one, other = (
            (column(rows, measure.metric), column(rows, measure.per)) for rows in (first[1], second[1])
        )
        difference = estimate_ratio_difference(one, other, clusters)
        p_value, effect = ratio_exchange_test(one, other, clusters), _quotient(one, other)
        return PairedComparison(measure, first[0], second[0], difference, p_value, effect)
    both = ~(np.isnan(a) | np.isnan(b))
    a, b = a[both], b[both]
    if clusters is not None:
        clusters = np.unique(clusters[both], return_inverse=True)[1]
    if measure.is_share:
        a, b = as_shares(a), as_shares(b)
        difference = estimate_share_difference(a, b, clusters)
    else:
        difference = estimate_mean(a - b, clusters, are_counts=measure.are_counts, signed=True)
    if measure.is_share and np.isin([a, b], (0.0, 1.0)).all():
        test = mcnemar_test(a, b, clusters)
        discordant = test.only_a + test.only_b
        p_value, effect = test.p_value, test.only_a / discordant if discordant else np.nan
    else:
        p_value, effect = sign_flip_test(a - b, clusters), _paired_d(a - b)
    if not len(a):
        p_value = np.nan
    return PairedComparison(measure, first[0], second[0], difference, float(p_value), float(effect))


def have_same_cases(first: Rows, second: Rows) -> bool:
    """Whether two evaluations have the same episodes in the same order."""
    return [_case(row) for row in first] == [_case(row) for row in second]


def _case(row: Mapping[str, Any]) -> tuple[object, ...]:
    # NaN, of an empty cell, is unequal to itself.
    found = (row.get(name) for name in _CASE)
    return tuple(None if value != value else value for value in found)


def _quotient(first: tuple[Array, Array], second: tuple[Array, Array]) -> float:
    (a, b), (c, d) = first, second
    above, below = np.nansum(a) * np.nansum(d), np.nansum(b) * np.nansum(c)
    return float(above / below) if below else float("nan")


def _paired_d(differences: Array) -> float:
    if len(differences) < 2:
        return float("nan")
    deviation = float(differences.std(ddof=1))
    return float(differences.mean()) / deviation if deviation > 0.0 else float("nan")
