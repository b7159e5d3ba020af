"""Wheel encoders: what they count is how far wheels turn, in whole counts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import STEP_S, WHEEL_RADIUS_M, Drive, Stage, every_backend
from states import begin, group_state, measure, resting
from wheels import ALL, WHEELS, Measured, on_wheels, reading, wheels_state, within_bounds

from dune_rl.sensors.wheels import Encoders, EncodersConf

IDEAL = EncodersConf(counts_per_turn=0)
COUNT_RAD = 2 * np.pi / 100


def encoders(conf: EncodersConf = IDEAL, scenes: int = 1, wheels: int = WHEELS) -> Encoders:
    return Encoders("encoders", on_wheels(conf, None, scenes, wheels), conf)


def after(sensor: Encoders, *angles: float) -> list[np.ndarray]:
    """Readings of a rover of one wheel, which begins at the first angle."""
    begin(sensor, ALL, wheels_state([[angles[0]]]))
    found = []
    for angle in angles[1:]:
        measure(sensor, wheels_state([[angle]]))
        assert within_bounds(sensor)
        found.append(reading(sensor))
    return found


@every_backend
@pytest.mark.parametrize("speed", [0.3, 0.8, -0.5])
def test_turns_add_up_to_the_way(backend, speed):
    sensor = encoders()
    measured = Measured(Drive(backend), sensor)
    start, turned = measured.drive.stage.position[0], np.zeros(WHEELS)
    for _ in range(100):
        measured.step(speed, 0.0)
        turned += reading(sensor)[:WHEELS]
    way = measured.drive.stage.position[0] - start
    assert abs(way) > 1.0
    np.testing.assert_allclose(turned * WHEEL_RADIUS_M, way, rtol=0.01)
    np.testing.assert_allclose(reading(sensor)[WHEELS:] * WHEEL_RADIUS_M, speed, rtol=0.01)


@every_backend
def test_each_wheel_is_told_in_the_order_of_its_joint(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 5.0])
    stage.step(40, [1.0, 2.0, 3.0, 4.0])
    before = stage.wheel_angles
    sensor = encoders()
    begin(sensor, ALL, wheels_state(before[None]))
    stage.step(10, [1.0, 2.0, 3.0, 4.0])
    measure(sensor, wheels_state(stage.wheel_angles[None]))
    np.testing.assert_allclose(reading(sensor), [0.05, 0.1, 0.15, 0.2, 1, 2, 3, 4], rtol=0.01)


@every_backend
def test_a_wheel_that_spins_counts_what_the_rover_does_not_go(backend):
    sensor = encoders()
    stage = Stage(backend)
    stage.place([0.0, 0.0, 5.0])
    begin(sensor, ALL, wheels_state(stage.wheel_angles[None]))
    turned = np.zeros(WHEELS)
    for _ in range(10):
        stage.step(10, 8.0)
        measure(sensor, wheels_state(stage.wheel_angles[None]))
        turned += reading(sensor)[:WHEELS]
    np.testing.assert_allclose(turned, stage.wheel_angles, rtol=1e-5)
    assert turned.min() > 2.0


@every_backend
def test_an_encoder_of_a_standing_rover_counts_nothing(backend):
    sensor = encoders(EncodersConf())
    measured = Measured(Drive(backend), sensor)
    for _ in range(40):
        measured.step(0.0, 0.0)
        np.testing.assert_array_equal(reading(sensor), 0.0)


def test_turns_are_whole_counts_and_speeds_are_turns_by_time():
    (found,) = after(encoders(EncodersConf(counts_per_turn=100), wheels=1), 0.0, 3.4 * COUNT_RAD)
    np.testing.assert_allclose(found, [3 * COUNT_RAD, 3 * COUNT_RAD / STEP_S], rtol=1e-6)


def test_what_a_step_rounds_away_the_next_one_brings():
    angles = COUNT_RAD * np.arange(11) * 0.32
    found = after(encoders(EncodersConf(counts_per_turn=100), wheels=1), *angles)
    np.testing.assert_allclose(
        [turned / COUNT_RAD for turned, _ in found], [0, 1, 0, 0, 1, 0, 0, 1, 0, 0], atol=1e-5
    )


@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=50), st.integers(1, 5000))
def test_counts_never_stray_by_more_than_half_a_one(steps, counts_per_turn):
    angles = np.cumsum([7.0, *steps])
    found = after(encoders(EncodersConf(counts_per_turn=counts_per_turn), wheels=1), *angles)
    total = np.cumsum([turned for turned, _ in found])
    half = np.pi / counts_per_turn
    assert np.abs(total - (angles[1:] - angles[0])).max() <= half + 1e-5


def test_an_ideal_encoder_tells_any_angle():
    found = after(encoders(wheels=1), 1.0, 1.0001, 0.9)
    np.testing.assert_allclose([turned for turned, _ in found], [0.0001, -0.1001], rtol=1e-4)


@pytest.mark.parametrize("counts_per_turn", [0, 7, 1152])
@pytest.mark.parametrize("fastest", [0.1, 33.3, 100.0])
def test_faster_than_is_counted_is_told_as_the_fastest(fastest, counts_per_turn):
    conf = EncodersConf(counts_per_turn=counts_per_turn, max_speed_radps=fastest)
    fast, back = after(encoders(conf, wheels=1), 0.0, 1e6, -1e6)
    np.testing.assert_array_equal(fast, -back)
    assert fast[1] == np.float32(fastest)


def test_begin_counts_afresh_only_where_told():
    sensor = encoders(EncodersConf(counts_per_turn=100), scenes=2, wheels=1)
    begin(sensor, np.array([True, True]), wheels_state([[0.0], [0.0]]))
    measure(sensor, wheels_state([[0.5], [0.5]]))
    other = reading(sensor, 1)
    # The first scene's robot is put down anew, its wheels at 0.
    begin(sensor, np.array([True, False]), wheels_state([[0.0], [0.5]]))
    np.testing.assert_array_equal(reading(sensor, 0), 0.0)
    np.testing.assert_array_equal(reading(sensor, 1), other)
    measure(sensor, wheels_state([[0.5], [1.0]]))
    np.testing.assert_allclose(reading(sensor, 0)[0], 8 * COUNT_RAD, rtol=1e-6)
    np.testing.assert_allclose(reading(sensor, 1)[0], 8 * COUNT_RAD, rtol=1e-6)


def test_readings_are_the_asker_s_own():
    sensor = encoders(wheels=1)
    after(sensor, 0.0, 0.1)
    sensor.read()["encoders"][:] = 9.0
    sensor.bounds()["encoders"][1][:] = 9.0
    assert reading(sensor)[0] == pytest.approx(0.1)
    assert sensor.bounds()["encoders"][1].max() == 100.0


def test_a_state_without_joints_is_refused():
    sensor, blind = encoders(), group_state(resting(1))
    with pytest.raises(ValueError, match=r"the state has no joints.*needs_joints"):
        measure(sensor, blind)


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("counts_per_turn", -1, "greater than or equal to 0"),
        ("counts_per_turn", 1.5, "valid integer"),
        ("counts_per_turn", 10**8, "less than or equal to 10000000"),
        ("max_speed_radps", 0.0, "greater than 0"),
        ("max_speed_radps", float("nan"), "finite"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(setting, value, told):
    with pytest.raises(ValueError, match=rf"{setting}\n.*{told}"):
        EncodersConf(**{setting: value})
