"""Trajectories through way-points: points, speed, yaw, pauses and modes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_worlds import wavy_world

from dune_rl.trajectories.plan import plan_on_ground

BEND = np.array([[-3.0, -2.0], [0.0, 1.5], [4.0, 0.5]])


@pytest.fixture(scope="module")
def world():
    return wavy_world()


def steps(actor):
    return np.linalg.norm(np.diff(actor.poses[:, :3], axis=0), axis=1)


def test_points_are_5_cm_apart_on_the_ground_at_constant_speed(world):
    actor = plan_on_ground(world, BEND, velocity=0.8, mode="once")
    np.testing.assert_allclose(actor.poses[:, 2], world.terrain.height(actor.poses[:, :2]), atol=1e-9)
    # The last step is what is left of the way. A chord is a little shorter than its arc.
    np.testing.assert_allclose(steps(actor)[:-1], 0.05, rtol=0.01)
    np.testing.assert_allclose(np.diff(actor.times)[:-1], 0.05 / 0.8, rtol=1e-9)
    assert 0.0 < np.diff(actor.times)[-1] <= 0.05 / 0.8 + 1e-9
    np.testing.assert_allclose(actor.poses[[0, -1], :2], BEND[[0, -1]], atol=1e-9)
    assert np.linalg.norm(actor.poses[:, :2] - BEND[1], axis=1).min() < 0.026


def test_yaw_points_to_the_next_pose_and_the_last_is_repeated(world):
    poses = plan_on_ground(world, BEND, mode="once").poses
    step = np.diff(poses[:, :2], axis=0)
    np.testing.assert_allclose(poses[:-1, 3], np.arctan2(step[:, 1], step[:, 0]), atol=1e-9)
    assert poses[-1, 3] == poses[-2, 3]


def test_a_way_through_two_points_is_straight():
    actor = plan_on_ground(wavy_world(0.0), np.array([[0.0, 0.0], [4.0, 2.0]]), mode="once")
    np.testing.assert_allclose(actor.poses[:, 1], actor.poses[:, 0] / 2, atol=1e-9)
    assert actor.duration_s == pytest.approx(np.hypot(4.0, 2.0))
    assert len(actor.times) == 91 and not actor.loop


def test_back_and_forth_returns_on_the_same_way(world):
    there = plan_on_ground(world, BEND, mode="once")
    both = plan_on_ground(world, BEND, mode="back_and_forth")
    assert both.loop and both.duration_s == pytest.approx(2 * there.duration_s)
    np.testing.assert_allclose(both.poses[: len(there.poses), :3], there.poses[:, :3], atol=1e-9)
    np.testing.assert_allclose(both.poses[::-1, :3], both.poses[:, :3], atol=1e-9)
    # Half-way it turns round.
    turn = both.poses[len(there.poses) - 1, 3] - both.poses[len(there.poses) - 2, 3]
    assert np.cos(turn) == pytest.approx(-1.0, abs=0.01)


def test_a_loop_is_closed_and_smooth(world):
    corners = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    actor = plan_on_ground(world, corners, mode="loop")
    assert actor.loop
    np.testing.assert_allclose(actor.poses[-1, :2], actor.poses[0, :2], atol=1e-9)
    # Once round, without a corner anywhere, at the seam neither.
    assert abs(actor.poses[-1, 3] - actor.poses[0, 3]) == pytest.approx(2 * np.pi, abs=1e-6)
    assert np.abs(np.diff(actor.poses[:, 3])).max() < 0.1


def test_pauses_hold_the_actor_at_its_way_points(world):
    pauses = np.array([1.0, 0.0, 2.5])
    actor = plan_on_ground(world, BEND, mode="back_and_forth", pauses_s=pauses)
    walked = plan_on_ground(world, BEND, mode="back_and_forth")
    assert actor.duration_s == pytest.approx(walked.duration_s + 3.5)
    still = np.flatnonzero(steps(actor) == 0.0)
    np.testing.assert_allclose(np.diff(actor.times)[still], [1.0, 2.5])
    np.testing.assert_allclose(actor.poses[still, :2], BEND[[0, 2]], atol=1e-9)
    # It turns while it stands.
    assert np.cos(actor.poses[still[1] + 1, 3] - actor.poses[still[1], 3]) == pytest.approx(-1.0, abs=0.01)
    # Everywhere else the speed is the same.
    moving = steps(actor) > 0.0
    assert (np.diff(actor.times)[moving] <= 0.05 + 1e-9).all()


@settings(max_examples=40, deadline=None)
@given(
    points=st.lists(st.tuples(st.floats(-6, 6), st.floats(-6, 6)), min_size=3, max_size=6),
    velocity=st.floats(0.1, 5.0),
    spacing=st.floats(0.03, 0.6),
    mode=st.sampled_from(["once", "loop", "back_and_forth"]),
    pause=st.sampled_from([0.0, 0.7]),
)
def test_speed_and_spacing_hold_for_any_way(world, points, velocity, spacing, mode, pause):
    corners = np.array(points)
    closed = np.concatenate([corners, corners[:1]])
    if np.linalg.norm(np.diff(closed, axis=0), axis=1).min() < 0.2:
        return
    pauses = np.full(len(corners), pause) if pause else None
    actor = plan_on_ground(world, corners, velocity=velocity, spacing_m=spacing, mode=mode, pauses_s=pauses)
    assert actor.times[0] == 0.0 and (np.diff(actor.times) > 0.0).all()
    moving = steps(actor) > 0.0
    # No chord is longer than its arc, which takes as long as the speed says, and is measured to 0.02 mm.
    assert (steps(actor)[moving] <= velocity * np.diff(actor.times)[moving] * 1.01 + 2e-5).all()
    # A point that is nearer to a stop than a thousandth of the spacing gives way to it.
    assert (velocity * np.diff(actor.times)[moving] <= spacing * (1 + 1.001e-3)).all()
    assert np.abs(np.diff(actor.poses[:, 3])).max() <= np.pi + 1e-3
