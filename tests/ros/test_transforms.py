"""Frames over frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.ros.transforms import Pose

ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)


@given(ANGLES, ANGLES)
def test_a_frame_between_two_leads_from_one_to_the_other(
    outer: tuple[float, float, float], inner: tuple[float, float, float]
) -> None:
    first = Pose(np.array([1.0, -2.0, 0.5]), rotation_from_angles(np.array(outer)))
    second = Pose(np.array([0.3, 4.0, -1.0]), rotation_from_angles(np.array(inner)))
    between = first @ second.inverse
    np.testing.assert_allclose(
        between.position + between.rotation @ second.position, first.position, atol=1e-12
    )
    np.testing.assert_allclose(between.rotation @ second.rotation, first.rotation, atol=1e-12)
