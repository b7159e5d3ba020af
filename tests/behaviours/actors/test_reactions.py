"""How people react to a robot, as HuNavSim has it."""

import numpy as np
import pytest
from stages import RADIUS_M, ROBOT_REACH_M, Stage

from dune_rl.geometry.frames import wrap_angle

# Three metres in front of the person, and beside the way to the place.
ROBOT = np.array([3.0, 1.0])
START = [[[0.0, 0.0, 0.0]]]
REACTIONS = ["regular", "impassive", "surprised", "curious", "scared", "threatening"]


def person(
    model: str, reaction: str, robot: np.ndarray = ROBOT, velocity: tuple = (0.0, 0.0), place=(8.0, 0.0)
) -> Stage:
    settings = {
        "name": model,
        "reaction": reaction,
        "notice_m": 5.0,
        "places": [list(place)],
        "pause_s": [99.0, 99.0],
    }
    return Stage(settings, START, robots=[robot.tolist()], robot_velocity=velocity)


def distances(track: np.ndarray, robot: np.ndarray = ROBOT) -> np.ndarray:
    return np.linalg.norm(track[:, 0, 0] - robot, axis=-1)


@pytest.mark.slow(all_but=["impassive-orca"])
@pytest.mark.parametrize("model", ["orca", "social_force"])
@pytest.mark.parametrize("reaction", ["regular", "impassive", "scared"])
def test_these_walk_on_to_their_place_past_the_robot(model: str, reaction: str) -> None:
    track = person(model, reaction).run(14.0)
    assert track[-1, 0, 0, 0] > 7.0
    assert distances(track).min() > RADIUS_M + ROBOT_REACH_M


@pytest.mark.slow
@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_the_scared_keep_farther_off_than_the_regular(model: str) -> None:
    scared, regular = (
        distances(person(model, reaction).run(14.0)).min() for reaction in ("scared", "regular")
    )
    assert scared > regular + 0.2


@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_the_surprised_stop_and_look_at_the_robot(model: str) -> None:
    stage = person(model, "surprised")
    track = stage.run(4.0)
    assert np.linalg.norm(track[-1, 0, 0] - track[40, 0, 0]) < 0.05
    offset = ROBOT - stage.places[0, 0]
    assert abs(wrap_angle(np.arctan2(offset[1], offset[0]) - stage.headings[0, 0])) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_the_curious_come_near_slowly_and_stop_at_a_distance(model: str) -> None:
    track = person(model, "curious", place=(0.0, -8.0)).run(12.0)
    assert distances(track)[-1] == pytest.approx(1.5, abs=0.25)
    # And leave when they have seen enough.
    later = person(model, "curious", place=(0.0, -8.0)).run(45.0)
    assert distances(later)[-1] > 4.0


@pytest.mark.parametrize("model", ["orca", "social_force"])
def test_the_threatening_get_in_front_of_the_robot(model: str) -> None:
    stage = person(model, "threatening", np.array([4.0, 2.0]), (-0.2, 0.0), place=(0.0, -8.0))
    stage.run(12.0)
    ahead = stage.robots[0, 0] - stage.places[0, 0]
    # The robot drives towards -x: the person is that much before it.
    assert 0.6 < ahead[0] < 2.0 and abs(ahead[1]) < 0.5


def test_who_has_the_robot_behind_does_not_react() -> None:
    ahead, behind = (person("orca", "surprised", np.array([x, 0.5])) for x in (3.0, -3.0))
    assert np.linalg.norm(ahead.run(1.0)[-1]) < 0.1 < np.linalg.norm(behind.run(1.0)[-1])


def test_reactions_differ_from_each_other() -> None:
    ends = np.array([person("orca", reaction).run(6.0)[-1, 0, 0] for reaction in REACTIONS])
    apart = np.linalg.norm(ends[:, None] - ends[None], axis=-1)[~np.eye(len(ends), dtype=bool)]
    assert apart.min() > 1e-3
