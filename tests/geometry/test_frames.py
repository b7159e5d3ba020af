"""Angles and rotations: what goes there comes back, and agrees with SciPy."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dune_rl.geometry.frames import (
    clip,
    cross,
    multiply_quaternions,
    quaternion_on_slope,
    quaternions,
    roll_pitch_yaw,
    rotation_matrices,
    to_body,
    to_world,
    wrap_angle,
)

component = st.floats(-1.0, 1.0)
unit_quaternions = (
    st.tuples(component, component, component, component)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
vectors = st.tuples(*[st.floats(-100.0, 100.0)] * 3).map(np.array)
yaws = st.floats(-np.pi, np.pi)


@given(st.floats(-1e4, 1e4))
@example(np.pi)
@example(-np.pi)
@example(3 * np.pi)
@example(float(np.nextafter(-np.pi, -4.0)))
def test_a_wrapped_angle_is_the_same_direction_in_the_half_open_turn(angle):
    wrapped = wrap_angle(np.asarray(angle))
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


@given(st.floats(-3.14, 3.14))
def test_an_angle_within_the_turn_stays(angle):
    assert wrap_angle(np.asarray(angle)) == pytest.approx(angle, abs=1e-12)


@given(unit_quaternions, vectors)
def test_vectors_go_to_the_world_and_back(quaternion, vector):
    rotation = rotation_matrices(quaternion)
    np.testing.assert_allclose(to_body(rotation, to_world(rotation, vector)), vector, atol=1e-9)
    np.testing.assert_allclose(
        to_world(rotation, vector), Rotation.from_quat(quaternion).apply(vector), atol=1e-9
    )


@given(unit_quaternions)
def test_rotation_matrices_are_rotations(quaternion):
    rotation = rotation_matrices(quaternion)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation, rotation_matrices(-quaternion), atol=1e-15)


@given(unit_quaternions)
@example(np.array([0.0, 0.0, 0.0, 1.0]))
@example(np.array([1.0, 0.0, 0.0, 0.0]))
@example(np.array([0.0, 1.0, 0.0, 0.0]))
@example(np.array([0.0, 0.0, 1.0, 0.0]))
def test_quaternions_come_back(quaternion):
    found = quaternions(rotation_matrices(quaternion))
    assert found[3] >= 0.0
    # Of half turns both signs are right.
    sign = np.sign(found @ quaternion)
    np.testing.assert_allclose(found, sign * quaternion, atol=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_roll_pitch_yaw_come_back(roll, pitch, yaw):
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(roll_pitch_yaw(rotation), [roll, pitch, yaw], atol=1e-7)


def test_nose_down_is_positive_pitch_and_left_side_up_is_positive_roll():
    nose_down = Rotation.from_rotvec([0, 0.3, 0]).as_matrix()
    assert (nose_down @ [1, 0, 0])[2] < 0
    assert roll_pitch_yaw(nose_down)[1] == pytest.approx(0.3)
    left_up = Rotation.from_rotvec([0.2, 0, 0]).as_matrix()
    assert (left_up @ [0, 1, 0])[2] > 0
    assert roll_pitch_yaw(left_up)[0] == pytest.approx(0.2)


@given(unit_quaternions, unit_quaternions)
def test_a_product_turns_by_the_second_then_the_first(first, second):
    product = rotation_matrices(multiply_quaternions(first, second))
    np.testing.assert_allclose(product, rotation_matrices(first) @ rotation_matrices(second), atol=1e-12)


@given(st.floats(0.0, 1.2), yaws, yaws)
def test_a_body_on_a_slope_has_its_normal_and_keeps_its_heading_when_level(slope, toward, yaw):
    normal = np.array([-np.sin(slope) * np.cos(toward), -np.sin(slope) * np.sin(toward), np.cos(slope)])
    rotation = rotation_matrices(quaternion_on_slope(3.0 * normal, np.asarray(yaw)))
    np.testing.assert_allclose(rotation[:, 2], normal, atol=1e-9)
    # The least turn that tilts leaves the horizontal direction across the slope alone.
    across = np.array([-np.sin(toward), np.cos(toward), 0.0])
    level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    assert rotation[:, 0] @ across == pytest.approx(level @ across, abs=1e-9)


@settings(max_examples=20)
@given(st.lists(unit_quaternions, min_size=6, max_size=6))
def test_batches_are_their_members(many):
    batch = np.array(many).reshape(2, 3, 4)
    rotations = rotation_matrices(batch)
    assert rotations.shape == (2, 3, 3, 3)
    np.testing.assert_array_equal(rotations[1, 2], rotation_matrices(batch[1, 2]))
    np.testing.assert_array_equal(roll_pitch_yaw(rotations)[0, 1], roll_pitch_yaw(rotations[0, 1]))
    vectors_b = batch[..., :3]
    np.testing.assert_allclose(
        to_world(rotations, vectors_b)[1, 0], rotations[1, 0] @ vectors_b[1, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        cross(vectors_b, vectors_b[::-1]), np.cross(vectors_b, vectors_b[::-1]), atol=1e-15
    )


@given(st.floats(-10, 10), st.floats(-3, 0), st.floats(0, 3))
def test_within_moves_no_more_than_it_must(value, low, high):
    assert clip(np.asarray(value), low, high) == np.clip(value, low, high)
