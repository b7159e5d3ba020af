"""A leg's kinematics there and back, where joints end, and what is done about what is out of reach."""

import numpy as np
import pytest

from dune_rl.robots.hyperdog import Leg

LEG = Leg(offset_m=0.1, upper_m=0.15, lower_m=0.14, knee_rad=(0.17, 2.62))
SIDES = np.array([1.0, -1.0])


def test_at_zero_it_hangs_straight_down_outward_of_the_hip():
    foot = LEG.foot(np.zeros((2, 3)), SIDES)
    np.testing.assert_allclose(foot, [[0.0, 0.1, -0.29], [0.0, -0.1, -0.29]], atol=1e-12)


@pytest.mark.parametrize(
    ("angles", "foot"),
    [
        # The hip takes the left leg up and out; upper and lower leg swing forward.
        ([np.pi / 2, 0.0, 0.0], [0.0, 0.29, 0.1]),
        ([0.0, np.pi / 2, 0.0], [0.29, 0.1, 0.0]),
        ([0.0, 0.0, np.pi / 2], [0.14, 0.1, -0.15]),
        ([0.0, -np.pi / 2, np.pi / 2], [-0.15, 0.1, -0.14]),
    ],
)
def test_a_turn_of_each_joint_takes_the_foot_where_it_should(angles, foot):
    np.testing.assert_allclose(LEG.foot(np.array(angles), np.array(1.0)), foot, atol=1e-12)


def test_there_and_back_over_the_whole_reach():
    draws = np.random.default_rng(0)
    angles = draws.uniform([-1.0, -1.2, 0.2], [1.0, 0.9, 2.4], (500, 2, 3))
    feet = LEG.foot(angles, SIDES)
    # The leg below the hip, not folded over it: there a second hip angle puts the foot at the same place.
    below = 0.15 * np.cos(angles[..., 1]) + 0.14 * np.cos(angles[..., 1] + angles[..., 2]) > 0.02
    assert below.mean() > 0.7
    found = LEG.angles(feet, SIDES)
    np.testing.assert_allclose(found[below], angles[below], atol=1e-9)


def test_left_and_right_are_mirror_images():
    foot = np.array([0.05, 0.12, -0.2])
    left, right = LEG.angles(np.stack([foot, foot * [1, -1, 1]]), SIDES)
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=1e-12)


@pytest.mark.parametrize("way", [(0.0, 0.1, -1.0), (0.4, 0.1, -0.4), (-0.3, 0.5, -0.6)])
def test_out_of_reach_the_leg_stretches_toward_it_as_far_as_its_knee_may(way):
    foot = np.array(way)
    angles = LEG.angles(foot, np.array(1.0))
    assert angles[2] == pytest.approx(0.17)
    reached = LEG.foot(angles, np.array(1.0))
    # In the plane of the leg, from the joint of the upper leg on, the directions are the same.
    middle = LEG.foot(np.array([angles[0], 0.0, 0.0]), np.array(1.0)) * [0, 1, 1]
    middle -= 0.29 * np.array([0.0, np.sin(angles[0]), -np.cos(angles[0])])
    one, other = reached - middle, foot - middle
    assert one @ other / np.linalg.norm(one) / np.linalg.norm(other) == pytest.approx(1.0, abs=1e-6)


def test_too_near_the_knee_bends_as_far_as_it_may_and_all_stays_finite():
    # The middle one lies within the circle that the hip's offset leaves free.
    feet = np.array([[0.0, 0.1, -0.01], [0.0, 0.02, -0.03], [0.0, 0.0, 0.0]])
    angles = LEG.angles(feet, np.ones(3))
    np.testing.assert_allclose(angles[:, 2], 2.62)
    assert np.isfinite(angles).all()
