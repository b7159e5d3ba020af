"""What rows of episodes and steps have beside metrics: the way to the goal, thinned steps, actors."""

import csv
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dune_rl import evaluate
from dune_rl.evaluation.recorder import steepest_slope_deg
from dune_rl.geometry.heightfield import HeightField

Call = Callable[..., int]
Row = dict[str, str]
WORDS = ("policy=go_to_goal", "+world=flat", "episodes=3", "scenes=2", "seed=4", "out=results")
LIMIT = "task.terminations.time_limit.max_steps=13"


def read(path: Path) -> list[Row]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_the_slope_of_a_way_is_the_steepest_ground_below_its_straight_line() -> None:
    # Level for x < 4, then 30 degrees up along x.
    rise = np.tan(np.deg2rad(30.0)) * np.maximum(np.arange(11) - 4.0, 0.0)
    terrain = HeightField(np.tile(rise, (11, 1)), 1.0, (0.0, 0.0))
    start = np.array([[1.0, 5.0], [1.0, 5.0], [6.0, 2.0], [2.0, 2.0]])
    goal = np.array([[3.5, 5.0], [8.0, 5.0], [6.0, 8.0], [2.0, 2.0]])
    # Flat, onto the ramp, across the ramp (its slope counts in whichever direction), and no way at all.
    np.testing.assert_allclose(steepest_slope_deg(terrain, start, goal), [0.0, 30.0, 30.0, 0.0], atol=1e-6)


def test_a_bump_narrower_than_the_way_is_found() -> None:
    heights = np.zeros((41, 401))
    heights[:, 200] = 0.05
    terrain = HeightField(heights, 0.1, (0.0, 0.0))
    found = steepest_slope_deg(terrain, np.array([[1.0, 2.0]]), np.array([[39.0, 2.0]]))
    assert found[0] == pytest.approx(np.degrees(np.arctan2(0.05, 0.1)))


def test_rows_of_episodes_have_the_way_to_the_goal(call: Call, folder: Path) -> None:
    assert call(evaluate.main, *WORDS, LIMIT, "actors=none") == 0
    for row in read(folder / "results" / "episodes.csv"):
        dx = float(row["goal_x_m"]) - float(row["start_x_m"])
        dy = float(row["goal_y_m"]) - float(row["start_y_m"])
        assert float(row["goal_distance_m"]) == pytest.approx(np.hypot(dx, dy))
        assert float(row["slope_deg"]) == pytest.approx(0.0, abs=1e-6)
    units = {row["column"]: row["unit"] for row in read(folder / "results" / "columns.csv")}
    assert (units["goal_distance_m"], units["slope_deg"]) == ("m", "°")
    # They are of the episodes, not of the policy: no measure is made of them.
    assert not {"goal_distance_m", "slope_deg"} & {
        row["measure"] for row in read(folder / "results" / "summary.csv")
    }


@pytest.mark.slow
def test_each_nth_step_and_the_last_are_those_of_all_steps(call: Call, folder: Path) -> None:
    for name, steps in (("all", "true"), ("some", "5")):
        words = [word for word in WORDS if not word.startswith("out=")]
        assert call(evaluate.main, *words, LIMIT, f"steps={steps}", f"out={name}") == 0
    some, full = (read(folder / name / "steps.csv") for name in ("some", "all"))
    for episode in ("0", "1", "2"):
        kept = [row for row in some if row["episode"] == episode]
        last = max(int(row["step"]) for row in full if row["episode"] == episode)
        assert [int(row["step"]) for row in kept] == sorted({*range(5, last, 5), last})
    assert all(row in full for row in some)
    assert {row["agent"] for row in some} == {"rover_0"}


def test_an_episode_that_ends_amid_a_held_action_keeps_its_last_step(call: Call, folder: Path) -> None:
    # Two scenes: one of them ends first, and rests until the action of both is over.
    assert call(evaluate.main, *WORDS, "actors=none", "physics.action_repeat=4", "steps=true") == 0
    counts = Counter(row["episode"] for row in read(folder / "results" / "steps.csv"))
    steps = {row["episode"]: int(row["steps"]) for row in read(folder / "results" / "episodes.csv")}
    assert any(each % 4 for each in steps.values())
    assert counts == {episode: -(-each // 4) for episode, each in steps.items()}


def test_actors_have_rows_with_a_pose_by_option(call: Call, folder: Path) -> None:
    assert call(evaluate.main, *WORDS, LIMIT, "actors=walkers", "steps=5", "actor_steps=true") == 0
    steps = read(folder / "results" / "steps.csv")
    robots = [row for row in steps if row["agent"] == "rover_0"]
    walkers = [row for row in steps if row["agent"] != "rover_0"]
    names = sorted({row["agent"] for row in walkers})
    assert len(names) >= 2
    for name in names:
        mine = [row for row in walkers if row["agent"] == name]
        assert [(row["episode"], row["step"]) for row in mine] == [
            (row["episode"], row["step"]) for row in robots
        ]
        assert all(np.isfinite([float(row["x_m"]), float(row["y_m"])]).all() for row in mine)
        assert {row["reward"] for row in mine} == {""} and {row["policy"] for row in mine} == {"go_to_goal"}


@pytest.mark.parametrize("word", ["steps=0", "steps=-2", "steps=1.5", "steps=often"])
def test_other_thinnings_are_refused(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], word: str
) -> None:
    assert call(evaluate.main, *WORDS, word) == 2
    told = capsys.readouterr().err
    assert "steps" in told and "a whole number N of at least 1 each N-th" in told


def test_actors_without_steps_are_refused(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(evaluate.main, *WORDS, "actor_steps=true") == 2
    assert "give steps=true or steps=N" in capsys.readouterr().err
