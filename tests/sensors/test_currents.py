"""Motor currents: torques in true physics balance weight and stall, and cost what motor and gear say."""

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    HULL_HALF_LENGTH_M,
    MASS_KG,
    WHEEL_RADIUS_M,
    Drive,
    allowed,
    box,
    every_backend,
    plane,
    quaternion_of,
)
from states import begin, measure
from wheels import ALL, WHEELS, Measured, on_wheels, reading, wheels_state, within_bounds

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.robots.rover_zero import RoverZeroConf, RoverZeroDriveConf
from dune_rl.robots.wheeled import SkidSteerConf
from dune_rl.sensors.wheels import Currents, CurrentsConf, EncodersConf

# An ampere for a newton metre, either way.
PLAIN = CurrentsConf(torque_constant_nm_per_a=1.0, gear_ratio=1.0, efficiency=1.0)


def currents(conf: CurrentsConf = PLAIN, scenes: int = 1, wheels: int = WHEELS) -> Currents:
    return Currents("currents", on_wheels(EncodersConf(), None, scenes, wheels), conf)


def current(conf: CurrentsConf, torque: float, speed: float) -> float:
    sensor = currents(conf, wheels=1)
    measure(sensor, wheels_state([[0.0]], speed, torque))
    assert within_bounds(sensor)
    return float(reading(sensor)[0])


def on_slope(backend, slope: float, heading: float = 0.0) -> Drive:
    quaternion = quaternion_of(heading, slope)
    up = rotation_matrices(quaternion)[:, 2]
    return Drive(
        backend, statics=[plane(slope)], quaternion=quaternion, position_w=up * (WHEEL_RADIUS_M + 0.001)
    )


# -- in physics ------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["*-0.2-*"])
@every_backend
@pytest.mark.parametrize("slope", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("uphill", [True, False], ids=["uphill", "downhill"])
def test_steady_driving_on_a_slope_takes_the_torque_of_the_weight(backend, slope, uphill):
    sensor = currents()
    measured = Measured(on_slope(backend, slope, 0.0 if uphill else np.pi), sensor)
    felt = []
    for step in range(100):
        measured.step(0.5, 0.0)
        if step >= 40:
            felt.append(reading(sensor))
    share = MASS_KG * GRAVITY_MPS2 * np.sin(slope) * WHEEL_RADIUS_M / WHEELS * (1 if uphill else -1)
    mean = np.mean(felt, axis=0)
    assert mean.sum() == pytest.approx(WHEELS * share, rel=0.05)
    # Wheels share the weight unevenly, and no wheel works against the others.
    np.testing.assert_allclose(mean, share, rtol=0.3)
    # DART's tyres swing a little on their springs.
    assert np.std(felt, axis=0).max() < 0.3 * abs(share) + allowed(backend, 0.0, 0.07)


@every_backend
def test_level_driving_takes_next_to_nothing(backend):
    sensor = currents()
    measured = Measured(Drive(backend), sensor)
    felt = []
    for step in range(80):
        measured.step(0.5, 0.0)
        if step >= 40:
            felt.append(reading(sensor))
    # A slope of one degree would take 0.06 N m a wheel.
    assert np.abs(np.mean(felt, axis=0)).max() < allowed(backend, 0.06, 0.09)


@every_backend
@pytest.mark.parametrize("torque", [0.6, 1.0])
def test_against_a_wall_motors_stall_at_the_drive_s_torque(backend, torque):
    conf = RoverZeroConf(drive=RoverZeroDriveConf(no_load_speed_radps=None, max_torque_nm=torque))
    wall = box((0.4 + HULL_HALF_LENGTH_M, 0.0), 0.2, 4.0, 1.0)
    sensor = currents()
    measured = Measured(Drive(backend, conf, [plane(), wall]), sensor)
    for _ in range(60):
        measured.step(0.5, 0.0)
    np.testing.assert_allclose(reading(sensor), torque, rtol=0.02)


@every_backend
def test_turning_on_the_spot_drives_the_sides_against_each_other(backend):
    sensor = currents()
    measured = Measured(Drive(backend), sensor)
    felt = []
    for _ in range(60):
        measured.step(0.0, 1.0)
        felt.append(reading(sensor))
    left, right = np.mean(felt[20:], axis=0).reshape(2, 2).T
    assert (left < -0.5).all() and (right > 0.5).all()


@every_backend
def test_a_new_episode_has_the_currents_of_its_own_start(backend):
    sensor = currents(CurrentsConf())
    measured = Measured(Drive(backend), sensor)
    first = reading(sensor)
    for _ in range(20):
        measured.step(1.0, 1.0)
    assert np.abs(reading(sensor) - first).max() > 0.1
    measured.drive.start(0.0)
    measured.begin()
    np.testing.assert_array_equal(reading(sensor), first)


# -- motor and gear --------------------------------------------------------------------------------


def test_torque_constant_and_gear_divide_the_torque():
    conf = CurrentsConf(torque_constant_nm_per_a=0.02, gear_ratio=50.0, efficiency=1.0, limit_a=20.0)
    assert current(conf, 3.0, 1.0) == pytest.approx(3.0)
    assert current(conf, -3.0, -1.0) == pytest.approx(-3.0)
    assert current(CurrentsConf(gear_ratio=50.0, torque_constant_nm_per_a=0.04), 3.0, 1.0) == pytest.approx(
        3.0 / (0.04 * 50.0 * 0.7)
    )


def test_losses_cost_the_motor_and_help_the_brake():
    conf = CurrentsConf(torque_constant_nm_per_a=0.1, gear_ratio=10.0, efficiency=0.5)
    assert current(conf, 2.0, 1.0) == pytest.approx(4.0)
    assert current(conf, -2.0, -1.0) == pytest.approx(-4.0)
    assert current(conf, 2.0, -1.0) == pytest.approx(1.0)
    assert current(conf, -2.0, 1.0) == pytest.approx(-1.0)
    assert current(conf, 2.0, 0.0) == pytest.approx(1.0)


def test_the_rover_s_full_torque_is_within_its_limit():
    torque = SkidSteerConf().max_torque_nm
    assert current(CurrentsConf(), torque, 1.0) == pytest.approx(torque / (0.017 * 96 * 0.7), rel=1e-6)
    assert current(CurrentsConf(), torque, 1.0) < CurrentsConf().limit_a


@pytest.mark.parametrize("limit", [0.1, 3.3, 10.0])
def test_currents_are_clipped_to_the_limit(limit):
    conf = CurrentsConf(limit_a=limit)
    assert current(conf, 1e9, 1.0) == np.float32(limit)
    assert current(conf, -1e9, -1.0) == -np.float32(limit)


def test_each_scene_has_its_own():
    sensor = currents(scenes=2, wheels=2)
    begin(
        sensor,
        np.array([True, True]),
        wheels_state(np.zeros((2, 2)), 1.0, np.array([[1.0, 2.0], [3.0, 4.0]])),
    )
    np.testing.assert_array_equal(sensor.read()["currents"], [[1, 2], [3, 4]])
    begin(
        sensor,
        np.array([True, False]),
        wheels_state(np.zeros((2, 2)), 1.0, np.array([[0.0, 0.5], [3.0, 4.0]])),
    )
    np.testing.assert_array_equal(sensor.read()["currents"], [[0, 0.5], [3, 4]])
    assert sensor.bounds()["currents"][0].shape == (2,)


def test_readings_are_the_asker_s_own():
    sensor = currents(wheels=1)
    begin(sensor, ALL, wheels_state([[0.0]], 1.0, 2.0))
    sensor.read()["currents"][:] = 9.0
    assert reading(sensor)[0] == 2.0


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("torque_constant_nm_per_a", 0.0, "greater than 0"),
        ("gear_ratio", -96.0, "greater than 0"),
        ("efficiency", 0.0, "greater than 0"),
        ("efficiency", 1.1, "less than or equal to 1"),
        ("limit_a", float("inf"), "finite"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(setting, value, told):
    with pytest.raises(ValueError, match=rf"{setting}\n.*{told}"):
        CurrentsConf(**{setting: value})
