"""The reading "velocity": forward speed and yaw rate."""

import numpy as np
from scanning import sensed_speed
from scenes import about
from states import motion_of

from dune_rl.sensors.own_motion import MAX_SENSED_SPEED_MPS


def test_sensed_speed_is_forward_in_the_body_frame_and_within_range():
    left = motion_of(np.array([0, 0, 0, *about([0, 0, 1], np.pi / 2), 0.3, 0.7, 0, 0, 0, 0.4]))
    np.testing.assert_allclose(sensed_speed(left), [[0.7, 0.4]], rtol=1e-6)
    fast = motion_of(np.array([0, 0, 0, 0, 0, 0, 1, -30.0, 0, 0, 0, 0, 100.0]))
    np.testing.assert_allclose(sensed_speed(fast), [[-MAX_SENSED_SPEED_MPS, 34.9]], rtol=1e-6)
