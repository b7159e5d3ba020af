"""The coverage and the false alarms that docs/reference/metrics.md states, by simulation. Slow."""

from collections.abc import Callable

import numpy as np
import pytest

from dune_rl.statistics.intervals import (
    Estimate,
    estimate_mean,
    estimate_proportion,
    estimate_share_difference,
)
from dune_rl.statistics.paired_comparison import mcnemar_test

pytestmark = pytest.mark.slow

Random = np.random.Generator
TRIALS = 1_500
# Three standard errors of a coverage of 0.9.
NEAR = 0.024
SITES, EACH = 50, 4
OF_SITE = np.repeat(np.arange(SITES), EACH)


def coverage(truth: float, estimate: Callable[[Random], Estimate], seed: int = 1) -> float:
    random = np.random.default_rng(seed)
    found = [estimate(random) for _ in range(TRIALS)]
    return float(np.mean([each.low <= truth <= each.high for each in found]))


def shares(random: Random, correlation: float) -> np.ndarray:
    """Successes of 80 % of the episodes, with this correlation between two episodes of a site."""
    size = (1 - correlation) / correlation if correlation else 1.0
    of_site = random.beta(0.8 * size, 0.2 * size, SITES) if correlation else np.full(SITES, 0.8)
    return random.random(SITES * EACH) < np.repeat(of_site, EACH)


@pytest.mark.parametrize(
    ("correlation", "as_episodes", "as_sites"), [(0.0, 0.95, 0.96), (0.1, 0.92, 0.95), (0.3, 0.85, 0.95)]
)
def test_coverage_of_shares(correlation: float, as_episodes: float, as_sites: float) -> None:
    of_sites = coverage(0.8, lambda random: estimate_proportion(shares(random, correlation), OF_SITE))
    of_episodes = coverage(0.8, lambda random: estimate_proportion(shares(random, correlation)))
    assert of_sites == pytest.approx(as_sites, abs=NEAR)
    assert of_episodes == pytest.approx(as_episodes, abs=NEAR)


@pytest.mark.parametrize("runs", [1, 3])
def test_coverage_of_differences_of_means_of_three_runs(runs: int) -> None:
    def estimate(random: Random) -> Estimate:
        of_site = np.repeat(random.beta(19.0, 1.0, SITES), EACH)
        both = (random.random((number, SITES * EACH)) < of_site for number in (3, runs))
        return estimate_share_difference(*(successes.mean(axis=0) for successes in both), OF_SITE)

    assert 0.95 <= coverage(0.0, estimate) <= 1.0


@pytest.mark.parametrize(("spread", "as_episodes"), [(0.5, 0.10), (1.0, 0.15)])
def test_false_alarms(spread: float, as_episodes: float) -> None:
    random = np.random.default_rng(3)

    def policy(common: np.ndarray) -> np.ndarray:
        own = np.repeat(random.normal(0.0, spread, SITES), EACH)
        return common + own + random.normal(0.0, 0.7, SITES * EACH) > 0.0

    p_values = []
    for _ in range(TRIALS):
        common = np.repeat(random.normal(0.8, 0.5, SITES), EACH) + random.normal(0.0, 0.7, SITES * EACH)
        a, b = policy(common), policy(common)
        p_values.append((mcnemar_test(a, b).p_value, mcnemar_test(a, b, OF_SITE).p_value))
    of_episodes, of_sites = np.mean(np.array(p_values) <= 0.05, axis=0)
    assert of_episodes == pytest.approx(as_episodes, abs=0.03)
    assert 0.02 <= of_sites <= 0.07


@pytest.mark.parametrize(
    ("share", "episodes", "low", "high"),
    # No event is likely, two to four are, ten are.
    [(0.01, 50, 0.97, 1.0), (0.01, 200, 0.83, 0.93), (0.02, 200, 0.85, 0.93), (0.05, 200, 0.93, 0.98)],
)
def test_coverage_of_rare_counts(share: float, episodes: int, low: float, high: float) -> None:
    def estimate(random: Random) -> Estimate:
        events = random.random(episodes) < share
        return estimate_mean(events * (1.0 + random.poisson(1.0, episodes)), are_counts=True)

    assert low <= coverage(2 * share, estimate) <= high


@pytest.mark.parametrize(("sites", "stated"), [(50, 0.95), (10, 0.91), (5, 0.89)])
def test_coverage_of_counts_over_few_sites(sites: int, stated: float) -> None:
    def estimate(random: Random) -> Estimate:
        values = random.poisson(np.repeat(random.gamma(0.5, 1.0, sites), EACH)).astype(float)
        return estimate_mean(values, np.repeat(np.arange(sites), EACH), are_counts=True)

    assert coverage(0.5, estimate) == pytest.approx(stated, abs=NEAR)


def test_coverage_of_skewed_values() -> None:
    found = coverage(np.exp(0.5), lambda random: estimate_mean(random.lognormal(0.0, 1.0, 100)))
    assert 0.90 <= found <= 0.95
