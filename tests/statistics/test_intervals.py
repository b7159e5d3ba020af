"""Intervals: that they cover as often as they say, and what they do at their limits."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from dune_rl.statistics.intervals import (
    Estimate,
    estimate_mean,
    estimate_proportion,
    estimate_ratio,
    estimate_ratio_difference,
    estimate_share_difference,
)

EPISODES, TRIALS = 100, 1000


def coverage(truth: float, estimate: Callable[[np.random.Generator], Estimate]) -> float:
    """How often the interval has the true value in it, of many samples."""
    random = np.random.default_rng(5)
    found = [estimate(random) for _ in range(TRIALS)]
    return float(np.mean([each.low <= truth <= each.high for each in found]))


def collisions(random: np.random.Generator, count: int = EPISODES) -> np.ndarray:
    """Numbers of collisions, most of them 0 and a few large; 0.5 in the mean."""
    return random.poisson(random.gamma(0.5, 1.0, count)).astype(float)


def of_means(random: np.random.Generator) -> Estimate:
    return estimate_mean(random.gamma(2.0, 1.0, EPISODES))


def of_collisions(random: np.random.Generator) -> Estimate:
    return estimate_mean(collisions(random))


def of_seconds_per_goal(random: np.random.Generator) -> Estimate:
    goals = random.integers(0, 4, EPISODES)
    return estimate_ratio(10.0 * goals + random.gamma(2.0, 2.5, EPISODES), goals)


def of_agents_of_an_episode(random: np.random.Generator) -> Estimate:
    """Four agents in each of 50 episodes, which have much in common."""
    episodes = np.repeat(np.arange(50), 4)
    common = np.repeat(random.normal(3.0, 1.0, 50), 4)
    return estimate_mean(common + random.normal(0.0, 0.3, 200), episodes)


def rare_collisions(random: np.random.Generator) -> np.ndarray:
    """Collisions in one episode of twenty, two in the mean; 0.1 over all."""
    return (random.random(EPISODES) < 0.05) * (1.0 + random.poisson(1.0, EPISODES))


def of_rare_collisions(random: np.random.Generator) -> Estimate:
    return estimate_mean(rare_collisions(random), are_counts=True)


def of_differences_of_rare_collisions(random: np.random.Generator) -> Estimate:
    return estimate_mean(rare_collisions(random) - rare_collisions(random), are_counts=True, signed=True)


def of_differences_of_seconds_per_goal(random: np.random.Generator) -> Estimate:
    goals = random.integers(0, 4, (2, EPISODES))
    times = [10.0, 12.0] * goals.T + random.gamma(2.0, 2.5, (EPISODES, 2))
    return estimate_ratio_difference((times[:, 0], goals[0]), (times[:, 1], goals[1]))


def of_differences_of_shares(random: np.random.Generator) -> Estimate:
    draws = random.random(EPISODES)
    return estimate_share_difference(draws < 0.85, (draws + 0.2 * random.random(EPISODES)) < 0.85)


def of_shares(random: np.random.Generator) -> Estimate:
    return estimate_proportion(random.random(EPISODES) < 0.85)


@pytest.mark.slow(all_but=["*shares", "*rare_collisions", "-2.0-of_differences*"])
@pytest.mark.parametrize(
    ("truth", "estimate"),
    [
        (2.0, of_means),
        (0.5, of_collisions),
        # 1.5 goals and 20 s an episode.
        ((15.0 + 5.0) / 1.5, of_seconds_per_goal),
        (3.0, of_agents_of_an_episode),
        (0.85, of_shares),
        (0.1, of_rare_collisions),
        (0.0, of_differences_of_rare_collisions),
        (-2.0, of_differences_of_seconds_per_goal),
        # Of draws between 0.65 and 0.85, half are pushed above 0.85.
        (0.1, of_differences_of_shares),
    ],
)
def test_an_interval_covers_as_often_as_it_says(
    truth: float, estimate: Callable[[np.random.Generator], Estimate]
) -> None:
    assert 0.93 <= coverage(truth, estimate) <= 0.97


@pytest.mark.slow
def test_agents_taken_for_independent_would_cover_too_seldom() -> None:
    def as_if_independent(random: np.random.Generator) -> Estimate:
        common = np.repeat(random.normal(3.0, 1.0, 50), 4)
        return estimate_mean(common + random.normal(0.0, 0.3, 200))

    assert coverage(3.0, as_if_independent) < 0.8


def test_a_ratio_is_that_of_the_sums() -> None:
    estimate = estimate_ratio([10.0, 30.0, 5.0, 15.0], [1.0, 2.0, 0.0, 1.0])
    assert estimate.value == pytest.approx(60.0 / 4.0) and estimate.low < 15.0 < estimate.high


def test_equal_ratios_have_equal_ends() -> None:
    estimate = estimate_ratio([1.0, 2.0, 3.0, 4.0], [2.0, 4.0, 6.0, 8.0])
    assert (estimate.low, estimate.value, estimate.high) == pytest.approx((0.5, 0.5, 0.5))


@pytest.mark.parametrize("count", [2, 3])
def test_a_few_values_have_no_bootstrap_interval(count: int) -> None:
    values = [1.0, 2.0, 3.0][:count]
    for found in (
        estimate_mean(values),
        estimate_mean(values, signed=True),
        estimate_ratio(values, [1.0] * count),
    ):
        assert (
            found.value == pytest.approx(np.mean(values)) and math.isnan(found.low) and math.isnan(found.high)
        )
    four = estimate_mean([1.0, 2.0, 3.0, 4.0])
    assert four.low < 2.5 < four.high
    # Events that are rare have intervals of a distribution.
    assert not math.isnan(estimate_mean([0.0, 0.0, 1.0], are_counts=True).high)


def test_what_is_unknown_is_no_success() -> None:
    known, clusters = [1.0, 0.0, 1.0, 1.0], [0, 0, 1, 1]
    with_unknown = [1.0, np.nan, 0.0, 1.0, np.nan, 1.0]
    assert estimate_proportion(with_unknown) == estimate_proportion(known)
    assert estimate_proportion(with_unknown, [0, 0, 0, 1, 2, 1]) == estimate_proportion(known, clusters)
    assert math.isnan(estimate_proportion([np.nan]).value)


def test_the_share_of_several_runs_of_an_episode_counts_as_one() -> None:
    runs = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0]])
    found = estimate_proportion(runs.mean(axis=0))
    assert found == estimate_proportion(runs[0])
    assert found.low == pytest.approx(0.150, abs=1e-3) and found.count == 4
    clusters = [0, 0, 1, 1]
    assert estimate_proportion(runs.mean(axis=0), clusters) == estimate_proportion(runs[1], clusters)


def test_a_ratio_to_nothing_is_unknown() -> None:
    assert math.isnan(estimate_ratio([1.0, 2.0], [0.0, 0.0]).value)
    assert math.isnan(estimate_ratio([], []).value)


def test_what_is_never_negative_has_no_negative_end() -> None:
    estimate = estimate_mean([0.0] * 30 + [1.0])
    assert 0.0 <= estimate.low < estimate.value < estimate.high


def test_one_cluster_has_no_interval() -> None:
    estimate = estimate_mean([1.0, 2.0, 3.0], [0, 0, 0])
    assert estimate.value == pytest.approx(2.0) and math.isnan(estimate.low) and estimate.count == 3


def test_without_an_event_the_interval_reaches_to_four_events_in_all() -> None:
    # -ln(0.025) = 3.689 events among 200 episodes.
    estimate = estimate_mean([0.0] * 200, are_counts=True)
    assert (estimate.value, estimate.low) == (0.0, 0.0)
    assert estimate.high == pytest.approx(3.6889 / 200, rel=1e-4)
    difference = estimate_mean([0.0] * 200, are_counts=True, signed=True)
    assert (difference.low, difference.high) == pytest.approx((-3.6889 / 200, 3.6889 / 200), rel=1e-4)


def test_without_an_event_times_have_no_interval() -> None:
    estimate = estimate_mean([0.0] * 200)
    assert estimate.value == 0.0 and math.isnan(estimate.low) and math.isnan(estimate.high)


def test_rare_single_events_have_the_poisson_interval() -> None:
    # Garwood's exact interval for 3 events: 0.6187 to 8.7673.
    estimate = estimate_mean([1.0] * 3 + [0.0] * 97, are_counts=True)
    assert (estimate.low, estimate.high) == pytest.approx((0.006187, 0.087673), rel=1e-3)


def test_a_difference_of_few_may_be_of_either_sign() -> None:
    estimate = estimate_mean([1.0] * 3 + [0.0] * 97, signed=True)
    assert estimate.value == pytest.approx(0.03) and estimate.low < 0.0 < estimate.high - 0.03


def test_a_difference_of_shares_without_discordant_pairs_has_an_interval() -> None:
    estimate = estimate_share_difference([1, 1, 0, 1], [1, 1, 0, 1])
    # Each side gets one pair of 4 + 2: 1.96 sqrt((1 / 6 + 1 / 6) / 6).
    assert (estimate.low, estimate.high) == pytest.approx((-0.46195, 0.46195), abs=1e-4)


def test_a_difference_of_shares_of_several_runs_is_between_those_of_single_ones() -> None:
    runs, other = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]), np.array([0.0, 0.0, 0.0, 1.0])
    single = [estimate_share_difference(run, other) for run in runs]
    mean = estimate_share_difference(runs.mean(axis=0), other)
    assert mean.value == pytest.approx(np.mean([one.value for one in single]))
    # (1 + 0.5 - 1 + 0) / 6, and 1.96 sqrt(((1 + 0.25 + 1 + 2) / 6 - (0.5 / 6)^2) / 6).
    assert (mean.low + mean.high) / 2 == pytest.approx(0.5 / 6)
    assert mean.high - mean.low == pytest.approx(
        2 * 1.96 * np.sqrt((4.25 / 6 - (0.5 / 6) ** 2) / 6), abs=1e-3
    )


def test_a_difference_of_ratios_is_that_of_both_sums() -> None:
    estimate = estimate_ratio_difference(([10.0, 30.0], [1.0, 3.0]), ([8.0, 4.0], [1.0, 2.0]))
    assert estimate.value == pytest.approx(10.0 - 4.0)
    assert math.isnan(estimate_ratio_difference(([1.0, 2.0], [0.0, 0.0]), ([1.0, 2.0], [1.0, 1.0])).value)
