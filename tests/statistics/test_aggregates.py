"""Aggregates over cases and runs: values known by arithmetic, and intervals that cover."""

import numpy as np
import pytest

from dune_rl.statistics.aggregates import (
    aggregate_scores,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
    run_scores,
    site_scores,
)

LEVELS = {"a": np.array([0.0, 0.2, 0.4, 0.6]), "b": np.array([0.5, 0.7, 0.9, 1.1])}


def test_the_interquartile_mean_is_that_of_the_middle_half() -> None:
    scores = np.array([9.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, -7.0])
    assert interquartile_mean(scores, np.ones(8)) == pytest.approx((1 + 2 + 3 + 4) / 4)
    # Of three, the quartiles cut the outer ones: a quarter of each counts, and all of the middle one.
    assert interquartile_mean(np.array([0.0, 4.0, 10.0]), np.ones(3)) == pytest.approx(
        (0.25 * 10 + 4.0) / 1.5
    )
    assert interquartile_mean(np.array([3.0]), np.ones(1)) == pytest.approx(3.0)


def test_weights_of_the_interquartile_mean_are_numbers_of_copies() -> None:
    scores, weights = np.array([1.0, 2.0, 5.0, 7.0]), np.array([3.0, 1.0, 2.0, 2.0])
    copies = np.repeat(scores, weights.astype(int))
    assert interquartile_mean(scores, weights) == pytest.approx(interquartile_mean(copies, np.ones(8)))


def test_aggregates_of_two_cases_by_arithmetic() -> None:
    found = aggregate_scores(LEVELS)
    # Sorted: 0, .2, .4, .5, .6, .7, .9, 1.1; the means of the cases are .3 and .8.
    assert found["IQM"].value == pytest.approx((0.4 + 0.5 + 0.6 + 0.7) / 4)
    assert found["mean"].value == pytest.approx(0.55)
    assert found["median"].value == pytest.approx(0.55)
    # The 1.1 counts as 1.
    assert found["optimality gap"].value == pytest.approx(1 - (4 * 0.3 + 0.5 + 0.7 + 0.9 + 1.0) / 8)
    for one in found.values():
        assert one.low < one.value < one.high and one.count == 8


def test_the_median_is_that_of_the_cases() -> None:
    scores = {name: np.array([value, value]) for name, value in (("a", 0.1), ("b", 0.2), ("c", 0.9))}
    assert aggregate_scores(scores)["median"].value == pytest.approx(0.2)


def test_cases_weigh_the_same_however_many_units_they_have() -> None:
    scores = {"a": np.zeros(40), "b": np.ones(4)}
    found = aggregate_scores(scores)
    assert found["mean"].value == pytest.approx(0.5) and found["IQM"].value == pytest.approx(0.5)


def test_equal_scores_have_intervals_without_width_and_none_have_none() -> None:
    found = aggregate_scores({"a": np.full(5, 0.4)})
    for name, value in (("IQM", 0.4), ("mean", 0.4), ("median", 0.4), ("optimality gap", 0.6)):
        assert (found[name].low, found[name].high) == pytest.approx((value, value))
    nothing = aggregate_scores({"a": np.zeros(0)})["IQM"]
    assert np.isnan(nothing.value) and nothing.count == 0


@pytest.mark.slow
def test_intervals_cover_what_they_estimate() -> None:
    draws = np.random.default_rng(3)
    hits = []
    for _ in range(200):
        scores = {name: draws.uniform(0.0, 1.0, 40) + shift for name, shift in (("a", 0.0), ("b", 1.0))}
        mean = aggregate_scores(scores)["mean"]
        hits.append(mean.low <= 1.0 <= mean.high)
    # Two standard errors of 200 draws are 3 %; percentiles of 40 cover a little less than 95 %.
    assert 0.89 <= np.mean(hits) <= 0.985


def test_a_profile_is_the_share_above_each_threshold() -> None:
    profile = performance_profile(LEVELS, np.array([-0.1, 0.2, 0.55, 2.0]))
    # "Above" is strict; each case weighs a half.
    np.testing.assert_allclose(profile.share, [1.0, (2 / 4 + 1) / 2, (1 / 4 + 3 / 4) / 2, 0.0])
    assert (profile.low <= profile.share).all() and (profile.share <= profile.high).all()
    assert profile.low[1] < profile.share[1]
    assert np.isnan(performance_profile({}, np.array([0.5])).share).all()


def test_the_probability_of_improvement_counts_pairs_and_half_of_ties() -> None:
    first, second = {"a": np.array([1.0, 2.0, 2.0])}, {"a": np.array([2.0, 0.0])}
    # Of six pairs three are won (each against 0), and two tie.
    found = probability_of_improvement(first, second)
    assert found.value == pytest.approx((3 + 0.5 * 2) / 6) and found.count == 1
    other = probability_of_improvement(second, first)
    assert found.value + other.value == pytest.approx(1.0)
    same = probability_of_improvement(LEVELS, LEVELS)
    assert same.value == pytest.approx(0.5) and same.low < 0.5 < same.high
    sure = probability_of_improvement({"a": np.ones(3)}, {"a": np.zeros(3)})
    assert (sure.value, sure.low, sure.high) == pytest.approx((1.0, 1.0, 1.0))


def test_methods_are_compared_on_the_cases_that_both_have() -> None:
    first = {"a": np.array([1.0]), "b": np.array([0.0]), "c": np.zeros(0)}
    second = {"a": np.array([0.0]), "c": np.array([9.0])}
    found = probability_of_improvement(first, second)
    assert (found.value, found.count) == (1.0, 1)
    assert probability_of_improvement({"a": np.ones(2)}, {"b": np.ones(2)}).count == 0


def test_units_are_the_means_of_sites_and_of_runs() -> None:
    rows = [
        {"episode": float(i), "world_seed": seed, "success": success}
        for i, (seed, success) in enumerate([(5.0, 1.0), (5.0, 0.0), (6.0, 1.0), (6.0, np.nan)])
    ]
    assert sorted(site_scores(rows, "success")) == [0.5, 1.0]
    seedless = [{**row, "world_seed": np.nan} for row in rows]
    assert sorted(site_scores(seedless, "success")) == [0.0, 1.0, 1.0]
    assert run_scores([rows[:2], rows[2:], rows[3:]], "success").tolist() == [0.5, 1.0]


def test_the_same_scores_give_the_same_intervals() -> None:
    assert aggregate_scores(LEVELS) == aggregate_scores({name: LEVELS[name].copy() for name in LEVELS})
