"""Rotations as quaternions, and frames over frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.ros.transforms import OPTICAL, quaternion_of, relative_pose

ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)


@given(ANGLES)
def test_quaternions_are_those_of_the_matrices(angles: tuple[float, float, float]) -> None:
    rotation = rotation_from_angles(np.array(angles))
    found = np.array(quaternion_of(rotation))
    assert found[3] >= 0.0 and np.linalg.norm(found) == pytest.approx(1.0)
    np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), rotation, atol=1e-12)


@pytest.mark.parametrize(
    "rotation", [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), OPTICAL]
)
def test_half_turns_have_quaternions(rotation: np.ndarray) -> None:
    found = Rotation.from_quat(quaternion_of(rotation)).as_matrix()
    np.testing.assert_allclose(found, rotation, atol=1e-12)


@given(ANGLES, ANGLES)
def test_a_frame_between_two_leads_from_one_to_the_other(
    outer: tuple[float, float, float], inner: tuple[float, float, float]
) -> None:
    first = np.array([1.0, -2.0, 0.5]), rotation_from_angles(np.array(outer))
    second = np.array([0.3, 4.0, -1.0]), rotation_from_angles(np.array(inner))
    position, rotation = relative_pose(first, second)
    np.testing.assert_allclose(position + rotation @ second[0], first[0], atol=1e-12)
    np.testing.assert_allclose(rotation @ second[1], first[1], atol=1e-12)
