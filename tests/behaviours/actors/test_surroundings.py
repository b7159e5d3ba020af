"""What behaviours know of the bodies and obstacles around."""

import numpy as np
import pytest
from stages import RADIUS_M, ROBOT_REACH_M, Stage
from yards import yard

HERE = [[[2.0, 0.0, 0.0], [0.0, 9.5, 0.0]], [[3.0, 0.0, 0.0], [0.0, -9.5, 0.0]]]


def test_all_bodies_of_a_scene_are_there_in_the_order_of_the_groups() -> None:
    stage = Stage({"name": "orca"}, HERE, robots=[[5.0, 6.0]], robot_velocity=(0.3, 0.4))
    around = stage.state().surroundings
    np.testing.assert_allclose(around.position_w[1], [[3.0, 0.0], [0.0, -9.5], [5.0, 6.0]])
    np.testing.assert_allclose(around.velocity_w[:, 2], [[0.3, 0.4]] * 2)
    np.testing.assert_allclose(around.reach_m, [RADIUS_M, RADIUS_M, ROBOT_REACH_M])
    assert around.is_robot.tolist() == around.are_of("robots").tolist() == [False, False, True]
    assert around.are_of("people").tolist() == [True, True, False]
    assert around.columns("robot") == slice(2, 3)


def test_the_nearest_obstacle_is_a_box_or_the_edge() -> None:
    # A box of 2 m whose near side is at x = 1.
    stage = Stage({"name": "orca"}, HERE, world=yard((0.0, 0.0, 0.0, 2.0, 2.0)))
    distance, direction = stage.state().surroundings.obstacles("people")
    np.testing.assert_allclose(distance[:, 0], [1.0, 2.0], atol=0.06)
    np.testing.assert_allclose(direction[:, 0], [[-1.0, 0.0]] * 2, atol=1e-6)
    # Bodies stop a metre before the edges at 10 m and -10 m.
    np.testing.assert_allclose(distance[:, 1], -0.5, atol=1e-9)
    np.testing.assert_allclose(direction[:, 1], [[0.0, 1.0], [0.0, -1.0]], atol=1e-9)


def test_they_are_computed_once_a_step() -> None:
    state = Stage({"name": "orca"}, HERE).state()
    assert state.surroundings is state.surroundings
    with pytest.raises(KeyError):
        state.surroundings.columns("nobody")
