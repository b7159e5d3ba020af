"""Paired comparisons of any number of policies on the same episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from dune_rl.learning.statistics import Estimate, estimate_mean, mcnemar_test
from dune_rl.metrics.catalogue import Measure, measures_of
from dune_rl.seeding import stream

Array = NDArray[np.float64]
Rows = Sequence[Mapping[str, float]]

_RESAMPLES = 9_999


@dataclass(frozen=True)
class PairedComparison:
    """One measure of two policies on the same episodes.

    `difference` is the mean of `first` minus `second` over the episodes in which both have a value, with a
    95 % bootstrap interval of whole episodes. `p_value` is of the exact McNemar test for shares and of a
    sign-flip permutation test for means, and `adjusted_p` the same by Holm's method over all pairs of
    policies. `effect` is Cohen's d of paired samples (mean over standard deviation of the differences) for
    means, and the share of discordant pairs that `first` wins for shares: 0.5 is no effect.
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
        if measure.per is not None:
            continue
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
    ids_a, ids_b = ([(row["episode"], row["agent"]) for row in rows] for rows in (first[1], second[1]))
    if ids_a != ids_b:
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    a, b = (np.array([row[measure.metric] for row in rows], float) for rows in (first[1], second[1]))
    both = ~(np.isnan(a) | np.isnan(b))
    a, b = a[both], b[both]
    numbers = np.array([row["episode"] for row in first[1]])[both]
    episodes = np.unique(numbers, return_inverse=True)[1]
    clusters = None if len(np.unique(episodes)) == len(episodes) else episodes
    difference = estimate_mean(a - b, clusters)
    if measure.is_share and clusters is None:
        test = mcnemar_test(a > 0, b > 0)
        discordant = test.only_a + test.only_b
        effect = test.only_a / discordant if discordant else np.nan
        p_value = test.p_value if len(a) else np.nan
    else:
        by_episode = np.bincount(episodes, a - b) / np.bincount(episodes) if len(a) else a
        p_value, effect = _permutation_test(by_episode), _paired_d(by_episode)
    return PairedComparison(measure, first[0], second[0], difference, float(p_value), float(effect))


def _permutation_test(differences: Array) -> float:
    """p-value of the two-sided sign-flip test that the mean difference is 0."""
    if len(differences) < 2 or not differences.any():
        return 1.0 if len(differences) else float("nan")
    test = stats.permutation_test(
        (differences,),
        lambda x, axis: np.mean(x, axis=axis),
        permutation_type="samples",
        vectorized=True,
        n_resamples=_RESAMPLES,
        batch=1_000,
        rng=stream(0, "permutation", len(differences)),
    )
    return float(test.pvalue)


def _paired_d(differences: Array) -> float:
    if len(differences) < 2:
        return float("nan")
    deviation = float(differences.std(ddof=1))
    return float(differences.mean()) / deviation if deviation > 0.0 else float("nan")
