"""The list of the nearest other agents, against places worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from sensor_contexts import carrier_of, context_of
from states import begin, group_state, resting, state_of

from dune_rl.sensors.neighbours import Neighbours, NeighboursConf
from dune_rl.state import GroupState, Motion
from dune_rl.state.body_description import BodyDescription


def placed(
    name: str, rows, *, count: int = 1, yaw: float = 0.0, velocity=(0.0, 0.0), kind="robot", **body
) -> GroupState:
    """Agents at `rows` (x, y), with one heading and velocity, and a body of a kind."""
    position, n = np.array([[x, y, 0.0] for x, y in rows]), len(rows)
    angles, velocities = np.tile([0.0, 0.0, yaw], (n, 1)), np.tile([*velocity, 0.0], (n, 1))
    motion = Motion(position, angles, velocities, np.zeros((n, 3)), np.zeros(n, bool))
    description = BodyDescription(kind=kind, is_robot=kind == "robot", **body)
    return replace(group_state(motion, count=count, name=name), body=description)


def read(conf: NeighboursConf, now: GroupState, *others: GroupState, fastest: float = 5.0) -> np.ndarray:
    """The list (N, k, 7) or (N, k, 9), which is checked against its bounds."""
    sensor = Neighbours(
        "neighbours", context_of(len(now.done), carrier=carrier_of(max_speed_mps=fastest - 10.0)), conf
    )
    sensor.measure(now, state_of(now, *others))
    reading = sensor.read()["neighbours"]
    low, high = sensor.bounds()["neighbours"]
    assert reading.shape == (len(now.done), *low.shape) and reading.dtype == low.dtype == np.float32
    assert (low <= reading).all() and (reading <= high).all()
    return reading.reshape(len(reading), conf.number, -1)


def test_the_nearest_come_first_in_the_frame_of_the_own_heading() -> None:
    # The agent faces north at 1 m/s: what is north is ahead, what is west is to the left.
    here = placed("walker", [(0.0, 0.0)], yaw=np.pi / 2, velocity=(0.0, 1.0), kind="person", radius_m=0.25)
    robot = placed("rover", [(-3.0, 0.0)], velocity=(0.5, 0.0), radius_m=0.2)
    cow = placed("cow", [(0.0, 2.0)], kind="cow", radius_m=0.6)
    (found,) = read(NeighboursConf(number=3), here, robot, cow)
    expected = [[1, 2, 0, -1, 0, 0.6, 0], [1, 0, 3, -1, -0.5, 0.2, 1], [0] * 7]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_own_group_is_listed_without_oneself() -> None:
    team = placed("team", [(0, 0), (1, 0), (5, 0), (0, 0), (7, 0), (8, 0)], count=3, kind="person")
    found = read(NeighboursConf(number=4, range_m=6.0), team)
    # Scenes are apart, and who is out of range is absent.
    assert found[:, :, 0].sum(axis=1).tolist() == [2, 2, 2, 0, 1, 1]
    np.testing.assert_allclose(found[0, :2, 1], [1, 5])
    np.testing.assert_allclose(found[4, 0, :3], [1, 1, 0])
    other = placed("rover", [(3.0, 0.0), (3.0, 0.0)])
    only = read(NeighboursConf(number=1, groups=("rover",)), team, other)
    np.testing.assert_allclose(only[:, 0, 1], [3, 2, -2, 3, -4, -5])


def test_goals_are_those_of_robots_alone() -> None:
    # The agent faces north at (1, 0); the robot's goal is 3 m north and 2 m west of it.
    here = placed("walker", [(1.0, 0.0)], yaw=np.pi / 2, kind="person")
    robot, other = placed("rover", [(1.0, 1.0)]), placed("cow", [(1.0, 2.0)], kind="cow")
    goals = [replace(each.goal, position_w=np.array([[-1.0, y]])) for each, y in ((robot, 3.0), (other, 5.0))]
    robot, other = replace(robot, goal=goals[0]), replace(other, goal=goals[1])
    (found,) = read(NeighboursConf(number=3, range_m=10.0, goals=True), here, robot, other)
    np.testing.assert_allclose(found[:, 7:], [[3.0, 2.0], [0.0, 0.0], [0.0, 0.0]], atol=1e-6)
    np.testing.assert_array_equal(found[:, :7], read(NeighboursConf(number=3), here, robot, other)[0])
    (near,) = read(NeighboursConf(number=1, range_m=2.5, goals=True), here, robot)
    np.testing.assert_allclose(near[0, 7:], [2.5, 2.0], atol=1e-6)


def test_relative_velocities_are_limited() -> None:
    here, there = placed("a", [(0.0, 0.0)]), placed("b", [(1.0, 0.0)], velocity=(-9.0, 2.0))
    (found,) = read(NeighboursConf(number=1), here, there, fastest=5.0)
    np.testing.assert_allclose(found[0, 3:5], [-5.0, 2.0])


def test_alone_the_list_is_empty() -> None:
    sensor = Neighbours("near", context_of(3), NeighboursConf(number=2))
    begin(sensor, np.ones(3, bool), group_state(resting(3), name="alone"))
    assert sensor.read()["near"].tolist() == [[0.0] * 14] * 3


@pytest.mark.parametrize("settings", [{"number": 0}, {"range_m": 0.0}])
def test_its_settings_have_ranges(settings) -> None:
    with pytest.raises(ValueError, match=next(iter(settings))):
        NeighboursConf(**settings)
