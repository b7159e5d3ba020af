"""Paired comparisons of any number of policies on the same episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.metrics.catalogue import measures_of
from dune_rl.metrics.measure import Measure
from dune_rl.statistics.intervals import (
    Estimate,
    estimate_difference,
    estimate_ratio_difference,
    estimate_share_difference,
)
from dune_rl.statistics.measures import CASE_COLUMNS, cluster_rows
from dune_rl.statistics.paired_tests import mcnemar_test, ratio_exchange_test, sign_flip_test

Rows = Sequence[Mapping[str, Any]]

# What tells the cases of two evaluations apart, where rows have it.
_CASE = (*CASE_COLUMNS, "episode", "agent")


@dataclass(frozen=True)
class PairedComparison:
    """One measure of two policies on the same episodes.

    `difference` is that of `first` minus `second`, with a 95 % interval; of means over the episodes in which
    both have a value. `p_value` is of the exact McNemar test for shares, and of a permutation test for the
    rest. Where a site has several episodes, or an episode several agents, both are over whole sites or
    episodes (`cluster_rows`), and shares have a permutation test too. `adjusted_p` is the same by Holm's
    method over all pairs of policies, for this measure alone. `effect` is the share of discordant pairs that
    `first` wins for shares (0.5: none), the quotient of both for ratios of sums (1: none), and for means
    Cohen's d of paired samples (mean over standard deviation of the differences; 0: none).
    """

    measure: Measure
    first: str
    second: str
    difference: Estimate
    p_value: float
    effect: float
    adjusted_p: float = np.nan


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
    if [_case(row) for row in first[1]] != [_case(row) for row in second[1]]:
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    clusters, _ = cluster_rows(first[1])
    a, b = (_column(rows, measure.metric) for rows in (first[1], second[1]))
    if measure.per is not None:
        one, other = (
            (_column(rows, measure.metric), _column(rows, measure.per)) for rows in (first[1], second[1])
        )
        difference = estimate_ratio_difference(one, other, clusters)
        p_value, effect = ratio_exchange_test(one, other, clusters), _quotient(one, other)
        return PairedComparison(measure, first[0], second[0], difference, p_value, effect)
    both = ~(np.isnan(a) | np.isnan(b))
    a, b = a[both], b[both]
    if clusters is not None:
        clusters = np.unique(clusters[both], return_inverse=True)[1]
    if measure.is_share:
        test = mcnemar_test(a > 0, b > 0, clusters)
        discordant = test.only_a + test.only_b
        difference = estimate_share_difference(a > 0, b > 0, clusters)
        p_value, effect = test.p_value, test.only_a / discordant if discordant else np.nan
    else:
        difference = estimate_difference(a - b, clusters, are_counts=measure.are_counts)
        p_value, effect = sign_flip_test(a - b, clusters), _paired_d(a - b)
    if not len(a):
        p_value = np.nan
    return PairedComparison(measure, first[0], second[0], difference, float(p_value), float(effect))


def _case(row: Mapping[str, Any]) -> tuple[object, ...]:
    # NaN, of an empty cell, is unequal to itself.
    found = (row.get(name) for name in _CASE)
    return tuple(None if value != value else value for value in found)


def _column(rows: Rows, name: str) -> Array:
    return np.array([row[name] for row in rows], float)


def _quotient(first: tuple[Array, Array], second: tuple[Array, Array]) -> float:
    (a, b), (c, d) = first, second
    above, below = np.nansum(a) * np.nansum(d), np.nansum(b) * np.nansum(c)
    return float(above / below) if below else float("nan")


def _paired_d(differences: Array) -> float:
    if len(differences) < 2:
        return float("nan")
    deviation = float(differences.std(ddof=1))
    return float(differences.mean()) / deviation if deviation > 0.0 else float("nan")
