"""Episodes that share a site: which rows belong together, and intervals and tests over whole sites."""

import math
from typing import Any

import numpy as np
import pytest

from dune_rl.evaluation.tables import comparison_table, paired_line
from dune_rl.reporting.comparison import Cases, Comparison, EvaluatedPolicy
from dune_rl.statistics.intervals import estimate_proportion, estimate_share_difference
from dune_rl.statistics.measures import cluster_rows, estimate_metrics
from dune_rl.statistics.paired_comparison import compare_policies, compare_success, mcnemar_test

SITES, EACH = 50, 4
OF_SITE = np.repeat(np.arange(SITES), EACH)
TRIALS = 600


def rows_of(success: Any, **columns: Any) -> list[dict[str, Any]]:
    """A row for each episode, with `success` and further columns, one value for all or one for each."""
    count = len(success)
    filled = {name: np.broadcast_to(np.asarray(values), count).tolist() for name, values in columns.items()}
    return [
        {"agent": 0.0, "episode": float(number), "success": float(success[number])}
        | {name: values[number] for name, values in filled.items()}
        for number in range(count)
    ]


# -- which rows belong together --------------------------------------------------------------------


def test_several_episodes_on_each_site_are_clusters() -> None:
    clusters, kind = cluster_rows(rows_of([1] * 6, world_seed=[500, 500, 501, 501, 502, 502]))
    assert kind == "sites" and clusters is not None and clusters.tolist() == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize(
    "columns",
    [
        {},
        {"world_seed": 7},
        {"world_seed": math.nan, "set": "flat-v1"},
        {"world_seed": [1, 2, 3, 4]},
        {"randomisation/world_seed": [1, 2, 3, 4]},
    ],
)
def test_episodes_on_one_site_or_each_on_its_own_are_independent(columns: dict[str, Any]) -> None:
    assert cluster_rows(rows_of([1, 0, 1, 1], **columns)) == (None, "episodes")


def test_agents_of_an_episode_are_together_and_all_of_a_site() -> None:
    rows = [
        {"agent": float(agent), "episode": float(e), "success": 1.0} for e in range(3) for agent in (0, 1)
    ]
    clusters, kind = cluster_rows(rows)
    assert kind == "episodes" and clusters is not None and clusters.tolist() == [0, 0, 1, 1, 2, 2]
    clusters, kind = cluster_rows([row | {"world_seed": 500.0 + (row["episode"] > 0)} for row in rows])
    assert kind == "sites" and clusters is not None and clusters.tolist() == [0, 0, 1, 1, 1, 1]


def test_sites_of_two_sets_are_different_ones() -> None:
    one = rows_of([1, 1], set="a-v1", world="a", world_seed=500)
    other = rows_of([1, 1], set="b-v1", world="b", world_seed=500)
    clusters, _ = cluster_rows([*one, *other])
    assert clusters is not None and clusters.tolist() == [0, 0, 1, 1]


# -- intervals and tests ---------------------------------------------------------------------------


def test_the_design_effect_by_hand() -> None:
    # Four sites of two equal episodes, half of them successes: the variance is twice that of eight
    # independent ones, and 4 / 3 of that for 3 degrees of freedom: as many as 3 independent episodes.
    found = estimate_proportion([1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 1, 1, 2, 2, 3, 3])
    t = 3.182446
    half = t / (1 + t**2 / 3) * math.sqrt(0.25 / 3 + t**2 / 36)
    assert (found.low, found.high) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-6)
    assert (found.value, found.count, found.units) == (0.5, 8, 4)


def successes(random: np.random.Generator) -> np.ndarray:
    """Successes with a share of 0.8 over all sites, which differ: a correlation within sites of 0.2."""
    return random.random(SITES * EACH) < np.repeat(random.beta(3.2, 0.8, SITES), EACH)


def test_the_interval_covers_for_new_sites_and_that_of_independent_episodes_does_not() -> None:
    random = np.random.default_rng(2)
    found = []
    for _ in range(TRIALS):
        hits = successes(random)
        estimates = estimate_proportion(hits, OF_SITE), estimate_proportion(hits)
        found.append([each.low <= 0.8 <= each.high for each in estimates])
    clustered, independent = np.mean(found, axis=0)
    assert 0.93 <= clustered <= 0.97
    assert independent < 0.92


def pair(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two policies that are equally good over all sites, each with sites of its own that it fails on."""
    return successes(random), successes(random)


@pytest.mark.slow
def test_the_test_over_sites_holds_its_level_and_that_of_mcnemar_does_not() -> None:
    random = np.random.default_rng(4)
    p_values, covered = [], []
    for _ in range(TRIALS):
        a, b = pair(random)
        p_values.append((mcnemar_test(a, b, OF_SITE).p_value, mcnemar_test(a, b).p_value))
        difference = estimate_share_difference(a, b, OF_SITE)
        covered.append(difference.low <= 0.0 <= difference.high)
    over_sites, over_episodes = np.mean(np.array(p_values) <= 0.05, axis=0)
    assert 0.02 <= over_sites <= 0.08
    assert over_episodes > 0.08
    assert np.mean(covered) >= 0.93


def test_evaluations_use_their_sites() -> None:
    random = np.random.default_rng(1)
    a, b = pair(random)
    of_a, of_b = (rows_of(hits, world_seed=500.0 + OF_SITE) for hits in (a, b))
    estimate = estimate_metrics(of_a)["SR"]
    assert estimate == estimate_proportion(a, OF_SITE) and estimate.units == SITES
    test = mcnemar_test(a, b, OF_SITE)
    assert compare_success(of_a, of_b) == test
    (one,) = compare_policies({"a": of_a, "b": of_b})
    assert one.p_value == test.p_value and one.difference.units == SITES
    assert "sign-flip test of whole sites" in paired_line(("a", of_a), ("b", of_b))
    plain = [rows_of(hits) for hits in (a, b)]
    assert "exact McNemar test" in paired_line(("a", plain[0]), ("b", plain[1]))


def test_other_sites_are_other_episodes() -> None:
    a, b = (rows_of([1, 0], world_seed=seeds) for seeds in ([1, 2], [1, 3]))
    with pytest.raises(ValueError, match="do not pair"):
        compare_policies({"a": a, "b": b})


def test_policies_that_do_the_same_are_shown_without_an_interval_that_nobody_knows() -> None:
    rows = rows_of([1, 1, 0], clearance=[1.0, 2.0, 3.0])
    table = comparison_table(compare_policies({"a": rows, "b": rows}), "OC")
    assert list(table.columns[1].cells) == ["0.00"]


def test_reports_keep_the_sites_of_rows() -> None:
    random = np.random.default_rng(1)
    a, b = pair(random)
    of_a, of_b = (
        rows_of(hits, world_seed=500.0 + OF_SITE, set="inspection-v1", world="inspection") for hits in (a, b)
    )
    rows = {name: [row | {"agent": "rover_0"} for row in of] for name, of in (("a", of_a), ("b", of_b))}
    cases = Cases("key", "inspection-v1", "inspection", "inspection-v1", "", "bullet", 1)
    comparison = Comparison(cases, [EvaluatedPolicy(name, name, found) for name, found in rows.items()])
    assert comparison.sites == SITES
    assert comparison.estimates["a"]["SR"] == estimate_proportion(a, OF_SITE)
    (one,) = comparison.pairs
    assert one.p_value == mcnemar_test(a, b, OF_SITE).p_value and one.difference.units == SITES
