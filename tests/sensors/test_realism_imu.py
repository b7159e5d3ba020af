"""The yaw of an inertial unit: integrated from a faulty gyroscope, it drifts by known laws."""

import numpy as np
import pytest
from instruments import ScriptedSensor, limits
from states import begin, episode_state, measure

from dune_rl.sensors.realism.pipeline import AngleNoiseConf, ImuRealismConf, NoiseConf, Realism
from dune_rl.sensors.sensor import PI32

STEP_S = 0.05
HIGH = [156.9] * 3 + [34.9] * 3 + [PI32] * 3
UNITS = 600


def run(
    conf: ImuRealismConf, steps: int, truth=0.0, units: int = UNITS, step_s: float = STEP_S
) -> np.ndarray:
    """Readings (steps + 1, units, 9) of units whose true reading is `truth` throughout."""
    told = ScriptedSensor({"imu": limits(HIGH)}, units)
    told.now["imu"][:] = truth
    sensor = Realism(told, conf, units, step_s)
    begin(sensor, np.ones(units, bool), episode_state(np.arange(units), 0))
    seen = [sensor.read()["imu"]]
    for step in range(1, steps + 1):
        measure(sensor, episode_state(np.arange(units), step))
        seen.append(sensor.read()["imu"])
    return np.array(seen, np.float64)


def gyroscope(**faults: float) -> ImuRealismConf:
    return ImuRealismConf(gyroscope=NoiseConf(**faults))


def test_a_perfect_gyroscope_gives_the_true_yaw():
    truth = [0.0, 0.0, 9.81, 0.3, -0.2, 0.5, 0.1, 0.2, -3.0]
    seen = run(ImuRealismConf(), 50, truth, units=2)
    assert (seen == np.float32(truth).astype(float)).all()


@pytest.mark.parametrize("rate_hz", [None, 5.0])
def test_white_noise_grows_as_the_root_of_time(rate_hz):
    density = 0.01
    conf = gyroscope(noise_density=density).model_copy(update={"rate_hz": rate_hz})
    yaw = run(conf, 200)[..., 8]
    # Angle random walk: N√t, whatever the rate of readings.
    for step in (20, 100, 200):
        assert yaw[step].std() == pytest.approx(density * np.sqrt(step * STEP_S), rel=0.12)
    assert (yaw[0] == 0.0).all()


def test_a_bias_turns_it_evenly():
    seen = run(gyroscope(bias=0.05), 100)
    for step in (1, 40, 100):
        np.testing.assert_allclose(seen[step, :, 8], seen[step, :, 5] * step * STEP_S, atol=1e-5)
    assert seen[100, :, 8].std() == pytest.approx(0.05 * 5.0, rel=0.1)


def test_a_random_walk_of_the_bias_grows_faster():
    walk, steps = 0.02, 200
    yaw = run(gyroscope(bias_walk=walk), steps)[..., 8]
    # The integral of a random walk: K √(t³ / 3).
    assert yaw[steps].std() == pytest.approx(walk * np.sqrt((steps * STEP_S) ** 3 / 3), rel=0.12)


def test_faults_add_up_as_their_variances():
    density, bias, time_s = 0.02, 0.01, 8.0
    yaw = run(gyroscope(noise_density=density, bias=bias), 160)[-1, :, 8]
    assert yaw.std() == pytest.approx(np.sqrt(density**2 * time_s + (bias * time_s) ** 2), rel=0.12)


def test_on_a_slope_both_other_axes_count():
    roll, pitch = 0.4, -0.5
    truth = np.array([0.0] * 6 + [roll, pitch, 1.0])
    seen = run(gyroscope(bias=0.05), 40, truth, units=50)
    rate = (seen[-1, :, 4] * np.sin(roll) + seen[-1, :, 5] * np.cos(roll)) / np.cos(pitch)
    np.testing.assert_allclose(seen[-1, :, 8], 1.0 + rate * 40 * STEP_S, atol=2e-5)


def test_a_magnetometer_does_not_drift():
    conf = ImuRealismConf(
        heading_from="magnetometer", gyroscope=NoiseConf(bias=0.05), heading=AngleNoiseConf(bias=0.04)
    )
    seen = run(conf, 100)
    assert (seen[:, :, 8] == seen[0, :, 8]).all()
    assert seen[0, :, 8].std() == pytest.approx(0.04, rel=0.1)
    assert seen[0, :, 5].std() == pytest.approx(0.05, rel=0.1)


def test_steps_between_values_are_not_integrated():
    # A unit integrates before it rounds what it tells: half a step of rate, told as none, is no drift.
    conf = gyroscope(quantum=0.1)
    seen = run(conf, 60, [0.0] * 5 + [0.04] + [0.0] * 3, units=3)
    assert (seen[..., 5] == 0.0).all() and (seen[..., 8] == 0.0).all()


def test_an_episode_begins_without_drift_and_passes_the_half_turn():
    told = ScriptedSensor({"imu": limits(HIGH)}, 2)
    told.now["imu"][:, 8] = 3.1
    sensor = Realism(told, gyroscope(bias=0.5), 2, STEP_S)
    begin(sensor, np.ones(2, bool), episode_state([3, 4], 0))
    for step in range(1, 41):
        measure(sensor, episode_state([3, 4], step))
    rates, yaws = sensor.read()["imu"][:, 5].astype(float), sensor.read()["imu"][:, 8].astype(float)
    off = yaws - (3.1 + rates * 2.0)
    np.testing.assert_allclose((off + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-5)
    assert (np.abs(yaws) <= PI32).all()
    begin(sensor, np.array([False, True]), episode_state([3, 9], [40, 0]))
    again = sensor.read()["imu"][:, 8].astype(float)
    assert again[0] == yaws[0] and again[1] == pytest.approx(3.1, abs=1e-6)


@pytest.mark.parametrize("part", ["mpu6050", "xsens_mti_1", "adis16448"])
def test_parts_without_a_heading_of_their_own_drift(part):
    yaw = run(ImuRealismConf.model_validate(part), 400, units=100)[..., 8]
    drift = yaw - yaw[0]
    assert drift[400].std() > 2.0 * drift[20].std() > 0.0
    # It begins with a compass's error of two degrees.
    assert yaw[0].std() == pytest.approx(np.deg2rad(2.0), rel=0.25)


@pytest.mark.parametrize("part", ["bno055", "xsens_mti_630"])
def test_parts_with_a_magnetometer_stay(part):
    yaw = run(ImuRealismConf.model_validate(part), 400, units=100)[..., 8]
    assert (yaw[400] == yaw[0]).all() and yaw[0].std() > 0.005
