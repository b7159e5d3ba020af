"""Paired comparisons: Holm's method by a published example, and figures known by arithmetic."""

import math

import numpy as np
import pytest

from dune_rl.metrics.catalogue import equation_of_p
from dune_rl.statistics.paired_comparison import (
    compare_policies,
    holm_adjusted,
    ratio_exchange_test,
    sign_flip_test,
)


def _rows(success: list[int], clearance: list[float]) -> list[dict[str, float]]:
    return [
        {"agent": 0.0, "episode": float(index), "success": float(a), "clearance": b}
        for index, (a, b) in enumerate(zip(success, clearance, strict=True))
    ]


def test_holm_by_hand() -> None:
    # Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1, never falling: 0.02, 0.03, 0.06, 0.06.
    assert holm_adjusted([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm_adjusted([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    adjusted = holm_adjusted([0.02, math.nan])
    assert adjusted[0] == pytest.approx(0.02) and math.isnan(adjusted[1])


def test_pairs_of_three_policies() -> None:
    spread = np.linspace(0.0, 1.0, 20)
    good = _rows([1] * 18 + [0] * 2, list(2.0 + spread))
    poor = _rows([0] * 10 + [1] * 8 + [1] * 2, list(1.0 + spread**2))
    found = compare_policies({"good": good, "poor": poor, "again": good})
    success = {(one.first, one.second): one for one in found if one.measure.name == "SR"}
    pair = success["good", "poor"]
    # 18 of 20 against 10 of 20; ten episodes only one solves, two only the other.
    assert pair.difference.value == pytest.approx(0.4)
    assert pair.difference.low < 0.4 < pair.difference.high
    assert pair.effect == pytest.approx(10 / 12)
    # Two-sided: 2 (C(12,0) + C(12,1) + C(12,2)) / 2^12.
    assert pair.p_value == pytest.approx(2 * 79 / 4096)
    assert pair.adjusted_p == pytest.approx(3 * pair.p_value)
    same = success["good", "again"]
    assert same.difference.value == 0 and same.p_value == 1 and math.isnan(same.effect)
    clearance = next(one for one in found if one.measure.name == "OC" and one.second == "poor")
    differences = 1.0 + spread - spread**2
    assert clearance.difference.value == pytest.approx(differences.mean())
    assert clearance.effect == pytest.approx(differences.mean() / differences.std(ddof=1))
    assert clearance.p_value < 0.01


def test_episodes_that_differ_do_not_pair() -> None:
    rows = _rows([1, 0], [1.0, 2.0])
    with pytest.raises(ValueError, match="do not pair"):
        compare_policies({"a": rows, "b": rows[:1]})
    assert compare_policies({"a": rows}) == []


def test_the_permutation_test_holds_its_level() -> None:
    draws = np.random.default_rng(3)
    rejected = 0
    for _ in range(200):
        a, b = draws.exponential(size=(2, 15)).tolist()
        (one,) = [
            x
            for x in compare_policies({"a": _rows([1] * 15, a), "b": _rows([1] * 15, b)})
            if x.measure.name == "OC"
        ]
        rejected += one.p_value <= 0.05
    # 200 draws of 0.05: 3 to 19 with a probability of 0.999.
    assert 2 <= rejected <= 20


def test_sign_flips_by_hand() -> None:
    # Of the 8 sums of +-1 +-2 +-3, two are as large as 6.
    assert sign_flip_test([1.0, 2.0, 3.0]) == pytest.approx(2 / 8)
    # Zeros have no part in it; of sums by cluster, 3 and 3, two of four are as large as 6.
    assert sign_flip_test([1.0, 2.0, 3.0, 0.0, 0.0]) == pytest.approx(2 / 8)
    assert sign_flip_test([1.0, 2.0, 3.0], [0, 0, 1]) == pytest.approx(2 / 4)
    assert sign_flip_test([0.0, 0.0]) == 1.0 and math.isnan(sign_flip_test([]))


def test_the_least_p_value_of_random_exchanges_is_a_bound() -> None:
    results = {"a": _rows([1] * 40, [2.0] * 40), "b": _rows([1] * 40, [1.0] * 40)}
    (one,) = [each for each in compare_policies(results) if each.measure.name == "OC"]
    assert one.p_is_bound and equation_of_p(one.p_value, is_bound=one.p_is_bound) == "p ≤ 0.0001"
    results = {"a": _rows([1] * 4, [2.0] * 4), "b": _rows([1] * 4, [1.0] * 4)}
    (few,) = [each for each in compare_policies(results) if each.measure.name == "OC"]
    assert not few.p_is_bound and equation_of_p(few.p_value, is_bound=few.p_is_bound) == "p = 0.12"


def test_exchanges_of_ratios_by_hand() -> None:
    # Episodes of 4 and 6 s against 1 and 2 s, with a goal each: 5 - 1.5. Exchanging either gives 2.5 - 4 or
    # 4 - 2.5; exchanging both 1.5 - 5.
    one, other = ([4.0, 6.0], [1.0, 1.0]), ([1.0, 2.0], [1.0, 1.0])
    assert ratio_exchange_test(one, other) == pytest.approx(2 / 4)
    assert ratio_exchange_test(one, one) == 1.0
    assert math.isnan(ratio_exchange_test(one, ([1.0, 2.0], [0.0, 0.0])))


def test_ratios_of_sums_are_compared() -> None:
    def rows(seconds: list[float], goals: list[float]) -> list[dict[str, float]]:
        return [
            {"agent": 0.0, "episode": float(index), "duration": a, "goals": b}
            for index, (a, b) in enumerate(zip(seconds, goals, strict=True))
        ]

    (one,) = compare_policies({"a": rows([4.0, 6.0], [1.0, 1.0]), "b": rows([3.0, 2.0], [1.0, 1.0])})
    assert one.measure.name == "s/goal" and one.effect == pytest.approx(2.0)
    assert one.difference.value == pytest.approx(2.5) and one.difference.low < 2.5 < one.difference.high


def test_the_exchange_of_ratios_holds_its_level() -> None:
    draws = np.random.default_rng(8)
    rejected = 0
    for _ in range(200):
        goals = (draws.random((2, 30)) < 0.7).astype(float)
        times = np.where(goals > 0, draws.gamma(4.0, 1.5, (2, 30)), 30.0)
        rejected += ratio_exchange_test((times[0], goals[0]), (times[1], goals[1])) <= 0.05
    assert 2 <= rejected <= 20
