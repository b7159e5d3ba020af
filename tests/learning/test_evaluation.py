"""Evaluation: the same episodes for everyone, and sound figures about them."""

import csv
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from point_mass import make_point_mass
from rich.console import Console

from dune_rl.core.files import write_csv
from dune_rl.evaluation.tables import results_table
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.networks.policy import Architecture, make_policy_network
from dune_rl.learning.policies import GoToGoal, UniformRandom
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.run.log import draw_curve
from dune_rl.statistics.intervals import estimate_mean, estimate_proportion
from dune_rl.statistics.measures import (
    average_metrics,
    estimate_metrics,
    selection_score,
)
from dune_rl.statistics.paired_comparison import compare_success, mcnemar_test

SPEC = PolicySpec.of(make_point_mass(1, 0), "rover")
GO_TO_GOAL = GoToGoal("rover", SPEC)


def network() -> GroupPolicy:
    return GroupPolicy("rover", SPEC, make_policy_network(SPEC, Architecture((8,))))


def episodes(policy, scenes: int, count: int, seed: int = 5, **more):
    return evaluate(policy, make_point_mass(scenes, 0), count, seed, **more)["rover"]


@pytest.mark.slow
def test_every_episode_once_whatever_the_batch() -> None:
    torch.manual_seed(1)
    for policy in (GO_TO_GOAL, Deterministic(network())):
        alone = episodes(policy, 1, 7)
        assert [row["episode"] for row in alone] == list(range(7))
        for scenes in (3, 7, 12):
            for a, b in zip(alone, episodes(policy, scenes, 7), strict=True):
                assert a == pytest.approx(b, nan_ok=True, abs=1e-5)


def test_what_the_battery_gives_is_told_where_it_was_measured() -> None:
    rows = episodes(GO_TO_GOAL, 2, 2)
    measured = [row | {"energy_wh": 0.5, "battery_share": 0.0125, "range_km": 3.0} for row in rows]
    assert not {"energy", "battery", "range"} & set(estimate_metrics(rows))
    assert estimate_metrics(measured)["range"].value == 3.0
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(results_table({"a": estimate_metrics(measured)}, ""))
    text = console.export_text()
    assert "energy  drawn from the battery [W h]" in text and "1.25 %" in text
    console.print(results_table({"a": estimate_metrics(rows)}, ""))
    assert "battery" not in console.export_text(clear=False).removeprefix(text)


def test_a_narrow_table_folds_meanings_before_numbers() -> None:
    estimate = estimate_mean([9.5, 18.25, 12.0, 11.0])
    results = {name: {"at risk/goal": estimate, "MTT": estimate} for name in ("go_to_goal", "inspection")}
    wide, narrow = (Console(record=True, width=width, file=io.StringIO()) for width in (200, 80))
    for console in (wide, narrow):
        console.print(results_table(results, ""))
    (interval,) = set(re.findall(r"[\d.]+ \([\d.]+ to [\d.]+\)", wide.export_text()))
    assert narrow.export_text().count(interval) == 4


def test_an_environment_can_be_evaluated_on_again() -> None:
    env = make_point_mass(3, 0)
    first = evaluate(GO_TO_GOAL, env, 8, seed=5)["rover"]
    other = evaluate(GO_TO_GOAL, env, 8, seed=6)["rover"]
    again = evaluate(GO_TO_GOAL, env, 8, seed=5)["rover"]
    assert all(a == pytest.approx(b, nan_ok=True) for a, b in zip(first, again, strict=True))
    assert [row["return"] for row in first] != [row["return"] for row in other]


def test_references_do_as_they_say() -> None:
    good = episodes(GO_TO_GOAL, 8, 30)
    poor = episodes(UniformRandom("rover", SPEC, 0), 8, 30)
    assert estimate_metrics(good)["SR"].value == 1
    assert estimate_metrics(poor)["SR"].value < 0.5
    test = compare_success(good, poor)
    assert test.only_a > 0 and test.only_b == 0 and test.p_value < 1e-3
    with pytest.raises(ValueError, match="do not pair"):
        compare_success(good, poor[:-1])


def test_go_to_goal_turns_before_it_drives() -> None:
    observation = make_point_mass(3, 0).reset()
    goals = torch.tensor([[2.0, 0.0], [2.0, 3.0], [2.0, -1.0]])
    observation["rover", "observation", "goal"] = goals.unsqueeze(1)
    action = GO_TO_GOAL(observation)["rover", "action"].squeeze(1)
    assert torch.allclose(action[:, 1], torch.tensor([0.0, 3.0, -1.0]))
    assert torch.allclose(action[:, 0], torch.tensor([0.8, 0.0, 0.8 * math.cos(1)]))


def test_random_states_are_left_alone() -> None:
    torch.manual_seed(7)
    np.random.seed(7)
    expected = torch.rand(3), np.random.rand(3)
    torch.manual_seed(7)
    np.random.seed(7)

    def careless(observation: object) -> object:
        np.random.rand()
        return observation.set(("rover", "action"), torch.rand(2, 1, 2))  # type: ignore[attr-defined]

    episodes(careless, 2, 3)  # type: ignore[arg-type]
    assert torch.equal(torch.rand(3), expected[0])
    assert np.array_equal(np.random.rand(3), expected[1])


def test_statistics_are_frozen_while_evaluating() -> None:
    module = network()
    before = {key: value.clone() for key, value in module.state_dict().items()}
    episodes(Deterministic(module), 2, 3)
    assert all(torch.equal(value, before[key]) for key, value in module.state_dict().items())


def test_stopping_returns_what_is_done() -> None:
    calls = iter([False] * 60 + [True])
    rows = episodes(GO_TO_GOAL, 2, 1000, stop=lambda: next(calls))
    assert 0 < len(rows) < 30


def test_wilson_interval() -> None:
    # Newcombe (1998), table I: 81 of 263 gives 0.2553 to 0.3662.
    estimate = estimate_proportion([1] * 81 + [0] * 182)
    assert (estimate.low, estimate.high) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert estimate_proportion([1] * 20).high == pytest.approx(1)
    assert math.isnan(estimate_proportion([]).value)


def test_mean_interval_covers_and_ignores_what_was_not_measured() -> None:
    values = np.random.default_rng(0).normal(3, 2, 400)
    estimate = estimate_mean([*values, math.nan])
    half = 1.96 * values.std() / 20
    assert estimate.count == 400
    assert estimate.value == pytest.approx(values.mean())
    expected = (values.mean() - half, values.mean() + half)
    assert (estimate.low, estimate.high) == pytest.approx(expected, abs=0.03)
    assert math.isnan(estimate_mean([0, 0, 0]).high)
    assert estimate_mean([2.0]).value == 2 and math.isnan(estimate_mean([2.0]).low)
    assert math.isnan(estimate_mean([math.nan]).value)


def test_exact_mcnemar() -> None:
    # Ten discordant pairs, nine one way: p = 2 (C(10,0) + C(10,1)) / 2^10.
    test = mcnemar_test([1] * 9 + [0] + [1] * 5, [0] * 9 + [1] + [1] * 5)
    assert (test.only_a, test.only_b) == (9, 1)
    assert test.p_value == pytest.approx(22 / 1024)
    assert mcnemar_test([1, 0], [1, 0]).p_value == 1


def test_csv_and_table_and_curve(tmp_path: Path) -> None:
    rows = episodes(GO_TO_GOAL, 4, 6)
    write_csv(tmp_path / "episodes.csv", rows)
    with (tmp_path / "episodes.csv").open() as file:
        read = list(csv.DictReader(file))
    assert len(read) == 6 and float(read[2]["episode"]) == 2
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(results_table({"go_to_goal": estimate_metrics(rows)}, "flat, 6 episodes"))
    text = console.export_text()
    assert "100.0 %" in text and "(61.0 to 100.0)" in text
    assert "VORT  velocity over rough terrain [m/s]" in text
    history = [{"kind": kind, "frames": 1000, **average_metrics(rows)} for kind in ("train", "eval")]
    draw_curve(history, tmp_path / "curve.png", "flat")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_metrics_of_ones_own_are_summed_up_beside_the_known_ones() -> None:
    rows = [{"agent": 0.0, "episode": float(e), "steps": 3.0, "return": e, "dust": 2.0 * e} for e in range(3)]
    assert list(estimate_metrics(rows)) == ["dust"]
    figures = average_metrics(rows)
    assert figures == {"dust": 2.0, "return": 1.0, "steps": 3.0}
    assert selection_score(figures) == 1.0 and selection_score(figures | {"SR": 0.5}) == 0.5
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(results_table({"a": estimate_metrics(rows)}, ""))
    assert "dust" in console.export_text()
