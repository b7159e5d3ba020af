"""The trot: which feet are in the air when, how high they rise, how far they step, and where they stand."""

import numpy as np
import pytest
from pydantic import ValidationError
from scenes import STEP_S

from dune_rl.robots.hyperdog import Trot, TrotConf

HIPS_B = np.array([[0.2, 0.1, 0.0], [0.2, -0.1, 0.0], [-0.2, 0.1, 0.0], [-0.2, -0.1, 0.0]])
LEVEL = np.zeros((1, 2))
# Many phases of a cycle: a control step would show but ten.
FINE_S = 0.005


def gait(twist, cycles: float = 4.0, tilt=LEVEL, step_s: float = FINE_S, **conf) -> tuple[Trot, np.ndarray]:
    """A trot and its feet (T, 4, 3) over its last cycles."""
    trot = Trot(TrotConf(**conf), HIPS_B, 1)
    count = round(cycles * TrotConf(**conf).cycle_s / step_s)
    return trot, np.array([trot.feet(np.array([twist]), tilt, step_s)[0] for _ in range(count)])


def in_the_air(trot: Trot, feet: np.ndarray) -> np.ndarray:
    return feet[:, :, 2] > trot.rest_b[:, 2] + 1e-6


def test_it_stands_under_its_hips():
    trot, feet = gait([0.0, 0.0])
    np.testing.assert_allclose(feet, np.broadcast_to(trot.rest_b, feet.shape), atol=1e-12)
    out = [[0, y, -0.22] for y in (0.1, -0.1, 0.1, -0.1)]
    np.testing.assert_allclose(trot.rest_b - HIPS_B, out, atol=1e-12)


@pytest.mark.parametrize("twist", [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.8]])
@pytest.mark.parametrize("share", [0.25, 0.4])
def test_diagonal_feet_rise_together_and_the_pairs_in_turn(twist, share):
    trot, feet = gait(twist, swing_share=share)
    air = in_the_air(trot, feet)
    np.testing.assert_array_equal(air[:, 0], air[:, 3])
    np.testing.assert_array_equal(air[:, 1], air[:, 2])
    assert not (air[:, 0] & air[:, 1]).any()
    np.testing.assert_allclose(air.mean(axis=0), share, atol=0.02)


def test_feet_rise_as_high_as_told_and_never_under_their_ground():
    trot, feet = gait([0.3, 0.2], lift_m=0.05)
    height = feet[:, :, 2] - trot.rest_b[:, 2]
    np.testing.assert_allclose(height.max(axis=0), 0.05, atol=2e-4)
    assert height.min() > -1e-12


@pytest.mark.parametrize("step_s", [FINE_S, STEP_S])
@pytest.mark.parametrize("speed", [0.4, 0.15, -0.3])
def test_a_stride_is_what_the_body_goes_in_a_stance_amid_which_the_foot_is_at_rest(speed, step_s):
    trot, feet = gait([speed, 0.0], step_s=step_s)
    cycle = feet[-round(0.5 / step_s) :]
    low, high = cycle[..., 0].min(axis=0), cycle[..., 0].max(axis=0)
    # The foot is put down and taken up within a step of the times that the phases say.
    np.testing.assert_allclose(high - low, abs(speed) * 0.75 * 0.5, atol=2 * abs(speed) * step_s)
    np.testing.assert_allclose((high + low) / 2, trot.rest_b[:, 0], atol=2 * abs(speed) * step_s)
    np.testing.assert_allclose(cycle[..., 1], np.broadcast_to(trot.rest_b[:, 1], cycle.shape[:2]), atol=1e-9)


def test_feet_on_the_ground_go_back_at_the_speed_and_round_as_it_turns():
    trot, feet = gait([0.3, 0.6])
    air = in_the_air(trot, feet)
    # Not in the step in which it is taken up.
    stays = ~(air[2:] | air[1:-1] | air[:-2])
    speed = np.diff(feet, axis=0)[:-1] / FINE_S
    turning = 0.6 * np.column_stack([-trot.rest_b[:, 1], trot.rest_b[:, 0], np.zeros(4)])
    expected = np.broadcast_to(-turning - [0.3, 0.0, 0.0], speed.shape)
    np.testing.assert_allclose(speed[stays], expected[stays], atol=1e-9)


@pytest.mark.parametrize(
    ("tilt", "aside"),
    [
        # Front up, pitch below zero: feet go back. Left side up: feet go to the right, which is lower.
        ([0.0, -0.2], [-0.22 * np.tan(0.2), 0.0, 0.0]),
        ([0.2, 0.0], [0.0, -0.22 * np.tan(0.2), 0.0]),
    ],
)
def test_on_a_slope_feet_stand_plumb_under_the_hips(tilt, aside):
    trot, feet = gait([0.0, 0.0], tilt=np.array([tilt]), step_s=STEP_S, cycles=10.0)
    np.testing.assert_allclose(feet[-1], trot.rest_b + aside, atol=1e-3)


def test_it_comes_to_stand_where_it_began():
    trot, _ = gait([0.3, 0.5])
    for _ in range(60):
        feet = trot.feet(np.zeros((1, 2)), LEVEL, STEP_S)
    np.testing.assert_allclose(feet[0], trot.rest_b, atol=1e-4)


def test_scenes_walk_apart_and_start_afresh():
    both, alone = Trot(TrotConf(), HIPS_B, 2), Trot(TrotConf(), HIPS_B, 1)
    twist = np.array([[0.3, 0.1], [-0.2, 0.6]])
    for _ in range(13):
        both.feet(twist, np.zeros((2, 2)), STEP_S)
    both.reset(np.array([False, True]))
    for _ in range(7):
        of_both = both.feet(twist, np.zeros((2, 2)), STEP_S)
        of_one = alone.feet(twist[1:], LEVEL, STEP_S)
    np.testing.assert_array_equal(of_both[1], of_one[0])


def test_it_takes_care_when_tilted():
    angles = {"slow_from_tilt_deg": np.rad2deg(0.2), "slow_to_tilt_deg": np.rad2deg(0.6)}
    trot = Trot(TrotConf(**angles, slow_speed_share=0.2), HIPS_B, 5)
    tilt = np.array([[0.0, 0.0], [0.1, -0.1], [0.0, 0.4], [0.24, -0.32], [-1.0, 0.5]])
    np.testing.assert_allclose(trot.speed_share(tilt), [1.0, 1.0, 0.6, 0.6, 0.2])


def test_care_that_ends_before_it_begins_is_refused():
    with pytest.raises(ValidationError, match="slow_to_tilt_deg must be above"):
        TrotConf(slow_from_tilt_deg=50.0, slow_to_tilt_deg=30.0)
