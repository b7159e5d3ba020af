"""What is told of a rover's true motion."""

import numpy as np
import pytest
from dune_rl.env.motion import Motion
from scanning import sensed_speed
from scenes import about

from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.sensors.velocity import MAX_SENSED_SPEED_MPS

ALL = np.array([True])


def state_of(
    position=(0, 0, 0), quaternion=(0, 0, 0, 1), velocity=(0, 0, 0), angular=(0, 0, 0)
) -> np.ndarray:
    return np.array([[*position, *quaternion, *velocity, *angular]], float)


def motion_at(**kwargs) -> Motion:
    motion = Motion(1, RoverZero(RoverZeroConf(), 1))
    motion.update(state_of(**kwargs))
    return motion


def test_sensed_speed_is_forward_in_the_body_frame_and_within_range():
    left = about([0, 0, 1], np.pi / 2)
    np.testing.assert_allclose(
        sensed_speed(motion_at(quaternion=left, velocity=(0.3, 0.7, 0), angular=(0, 0, 0.4))),
        [[0.7, 0.4]],
        rtol=1e-6,
    )
    fast = sensed_speed(motion_at(velocity=(-30.0, 0, 0), angular=(0, 0, 100.0)))
    np.testing.assert_allclose(fast, [[-MAX_SENSED_SPEED_MPS, 34.9]], rtol=1e-6)


def test_a_goal_s_bearing_is_from_the_nose_to_the_left():
    motion = motion_at(position=(1, 1, 0), quaternion=about([0, 0, 1], np.pi / 2))
    for point, bearing in (((1, 5), 0.0), ((-3, 1), np.pi / 2), ((5, 1), -np.pi / 2), ((2, 2), -np.pi / 4)):
        assert motion.bearing(np.array([point], float)) == pytest.approx(bearing)
    assert abs(motion.bearing(np.array([[1.0, -5.0]]))) == pytest.approx(np.pi)


@pytest.mark.parametrize(
    "broken",
    [
        {"velocity": (np.nan, 0, 0)},
        {"velocity": (0, 60.0, 0)},
        {"angular": (0, 0, -300.0)},
        {"position": (1e6, 0, 0)},
    ],
)
def test_a_state_that_cannot_be_leaves_the_last_good_one(broken):
    motion = motion_at(position=(1, 2, 3), velocity=(0.5, 0, 0))
    motion.update(state_of(**broken))
    assert motion.diverged.all()
    np.testing.assert_array_equal(motion.position_w, [[1, 2, 3]])
    np.testing.assert_array_equal(motion.velocity_b, [[0.5, 0, 0]])
    motion.update(state_of(position=(1, 2, 3)))
    assert not motion.diverged.any()


def test_steps_since_moved_counts_from_the_last_place_left():
    motion = motion_at()
    motion.begin(ALL)
    counts = []
    for x in (0.0, 0.05, 0.09, 0.12, 0.12, 0.2, 0.23):
        motion.update(state_of(position=(x, 0, 0)))
        counts.append(int(motion.steps_since_moved(0.1)[0]))
    assert counts == [1, 2, 3, 0, 1, 2, 0]
