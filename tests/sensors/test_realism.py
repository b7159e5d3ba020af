"""Rate, latency, noise, biases and steps round any sensor."""

import numpy as np
import pytest
from instruments import ScriptedSensor, limits
from states import begin, episode_state, measure

from dune_rl.sensors.realism.pipeline import (
    AngleNoiseConf,
    ImuRealismConf,
    NoiseConf,
    ReadingRealismConf,
    Realism,
    RealismConf,
    SpeedRealismConf,
    realistic,
)
from dune_rl.sensors.sensor import PI32

STEP_S = 0.05
IMU_HIGH = [156.9] * 3 + [34.9] * 3 + [PI32] * 3


def imu(scenes: int) -> ScriptedSensor:
    return ScriptedSensor({"imu": limits(IMU_HIGH)}, scenes)


def speed(scenes: int) -> ScriptedSensor:
    return ScriptedSensor({"velocity": limits([10.0, 34.9])}, scenes)


def run(sensor: Realism, told: ScriptedSensor, name: str, steps, truth, episodes=(0,)) -> np.ndarray:
    """Readings (steps + 1, M, n) of an episode in which `truth(step)` is told."""
    episodes = np.asarray(episodes)
    seen = []
    for step in range(steps + 1):
        told.now[name][:] = truth(step)
        now = episode_state(episodes, step)
        if step == 0:
            begin(sensor, np.ones(len(episodes), bool), now)
        else:
            measure(sensor, now)
        seen.append(sensor.read()[name])
    return np.array(seen)


def imu_run(conf: ImuRealismConf, steps: int, truth=lambda step: 0.0, episodes=(0,), step_s=STEP_S):
    told = imu(len(episodes))
    return run(Realism(told, conf, len(episodes), step_s), told, "imu", steps, truth, episodes)


# -- timing -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("conf", "expected"),
    [
        (RealismConf(), [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (RealismConf(rate_hz=20.0), [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (RealismConf(rate_hz=6.667), [0, 0, 0, 3, 3, 3, 6, 6, 6]),
        (RealismConf(latency_s=0.1), [0, 0, 0, 1, 2, 3, 4, 5, 6]),
        (RealismConf(rate_hz=10.0, latency_s=0.15), [0, 0, 0, 0, 0, 2, 2, 4, 4]),
    ],
)
def test_readings_are_held_and_come_late(conf, expected):
    told = speed(2)
    seen = run(Realism(told, conf, 2, STEP_S), told, "velocity", 8, lambda step: step, (0, 1))
    assert seen[:, 1, 0].tolist() == expected


def test_each_scene_is_on_its_own_time_and_begins_without_a_past():
    told = speed(2)
    sensor = Realism(told, RealismConf(rate_hz=10.0, latency_s=0.1), 2, STEP_S)
    both, second = np.array([True, True]), np.array([False, True])
    told.now["velocity"][:] = 0.0
    begin(sensor, both, episode_state([0, 1], 0))
    seen = []
    for step in range(1, 9):
        told.now["velocity"][:] = step
        measure(sensor, episode_state([0, 1], [step, step if step < 4 else step - 3]))
        if step == 3:
            told.now["velocity"][:] = 9.5
            before = sensor.read()["velocity"]
            begin(sensor, second, episode_state([0, 3], [3, 0]))
            after = sensor.read()["velocity"]
            assert np.array_equal(before[0], after[0])
            assert (after[1] == 9.5).all()
        seen.append(sensor.read()["velocity"][:, 0].tolist())
    assert [first for first, _ in seen] == [0, 0, 0, 2, 2, 4, 4, 6]
    # Its second episode began at step 3: it reads at 5 and 7, and these come two steps later.
    assert [late for _, late in seen] == [0, 0, 9.5, 9.5, 9.5, 9.5, 5, 5]
    assert [mask.tolist() for mask in told.begun] == [[True, True], [False, True]]


def test_without_faults_every_byte_stays():
    told = imu(3)
    assert realistic(told, None, 3, STEP_S) is told
    rng = np.random.default_rng(0)
    truth = rng.uniform(-3.1, 3.1, (6, 3, 9)).astype(np.float32)
    seen = run(
        Realism(told, ImuRealismConf(), 3, STEP_S), told, "imu", 5, lambda step: truth[step], (0, 1, 2)
    )
    assert seen.tobytes() == truth.tobytes()


def test_readings_do_not_alias():
    told = speed(1)
    sensor = Realism(told, RealismConf(), 1, STEP_S)
    begin(sensor, np.array([True]), episode_state([0], 0))
    sensor.read()["velocity"][:] = 7.0
    assert (sensor.read()["velocity"] == 0.0).all()
    assert sensor.bounds() is told.bounds()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate_hz": 30.0}, "rate_hz=30 is above the control rate of 20 Hz; write 20 or a whole fraction"),
        ({"rate_hz": 15.0}, "rate_hz=15 does not divide the control rate of 20 Hz; write 20 or 10"),
        ({"rate_hz": 7.0}, "write 10 or 6.667"),
        (
            {"latency_s": 0.12},
            "latency_s=0.12 is not a whole number of .* 0.05 s; write 0.1 or 0.15",
        ),
    ],
)
def test_times_that_no_control_step_has_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Realism(speed(1), RealismConf(**settings), 1, STEP_S)


# -- noise ------------------------------------------------------------------------------------------


def allan_deviation(readings: np.ndarray, step_s: float, tau_s: float) -> np.ndarray:
    """Overlapping Allan deviation at `tau_s` of readings (T, K), from their running sum."""
    size = round(tau_s / step_s)
    angle = np.concatenate([np.zeros((1, readings.shape[1])), np.cumsum(readings, axis=0)]) * step_s
    second = angle[2 * size :] - 2 * angle[size:-size] + angle[: -2 * size]
    return np.sqrt((second**2).mean(axis=0) / 2) / tau_s


@pytest.mark.slow
def test_an_hour_s_allan_deviation_tells_the_configured_noise_and_walk():
    # Eight units at rest for an hour, at 5 Hz: 24 axes of each kind.
    step_s, units = 0.2, 8
    conf = ImuRealismConf(
        heading_from="magnetometer",
        accelerometer=NoiseConf(noise_density=2.0e-3, bias_walk=2.0e-4),
        gyroscope=NoiseConf(noise_density=1.7e-4, bias_walk=2.0e-5),
    )
    hour = imu_run(conf, round(3600 / step_s), episodes=np.arange(units), step_s=step_s).astype(np.float64)
    assert not hour[:, :, 6:].any()
    for axes, noise, walk in ((slice(0, 3), 2.0e-3, 2.0e-4), (slice(3, 6), 1.7e-4, 2.0e-5)):
        at_rest = hour[:, :, axes].reshape(len(hour), -1)
        # White noise alone at a fifth of a second, N/√τ; at five minutes the walk, K√(τ/3).
        found = np.sqrt((allan_deviation(at_rest, step_s, 0.2) ** 2).mean()) * np.sqrt(0.2)
        assert found == pytest.approx(noise, rel=0.02)
        found = np.sqrt((allan_deviation(at_rest, step_s, 300.0) ** 2).mean()) / np.sqrt(300.0 / 3)
        assert found == pytest.approx(walk, rel=0.15)
        # Between them both: the slopes meet.
        both = np.sqrt(noise**2 / 20.0 + walk**2 * 20.0 / 3)
        found = np.sqrt((allan_deviation(at_rest, step_s, 20.0) ** 2).mean())
        assert found == pytest.approx(both, rel=0.08)


def test_bias_instability_is_the_highest_allan_deviation():
    step_s = 1.0
    wandering = NoiseConf(bias_instability=0.01, bias_correlation_s=20.0)
    conf = ImuRealismConf(gyroscope=wandering)
    readings = imu_run(conf, 3600, episodes=np.arange(60), step_s=step_s)[:, :, 3:6].reshape(3601, -1)
    found = {tau: np.sqrt((allan_deviation(readings, step_s, tau) ** 2).mean()) for tau in (5.0, 38.0, 400.0)}
    assert found[38.0] == pytest.approx(0.01, rel=0.03)
    assert max(found[5.0], found[400.0]) < 0.8 * found[38.0]
    # It has been running before the episode begins.
    assert readings[0].std() == pytest.approx(readings[1800].std(), rel=0.25)


def test_the_noise_s_density_does_not_depend_on_the_rate():
    conf = ImuRealismConf(accelerometer=NoiseConf(noise_density=0.1), rate_hz=5.0)
    seen = imu_run(conf, 800, episodes=np.arange(20))[::4, :, :3]
    assert seen.std() == pytest.approx(0.1 * np.sqrt(5.0), rel=0.02)
    mixed = ImuRealismConf(accelerometer=NoiseConf(noise=0.3, noise_density=0.4 / np.sqrt(5.0)), rate_hz=5.0)
    seen = imu_run(mixed, 800, episodes=np.arange(20))[::4, :, :3]
    assert seen.std() == pytest.approx(0.5, rel=0.02)


def test_a_bias_is_constant_over_an_episode_and_its_own_on_each_axis():
    conf = ImuRealismConf(accelerometer=NoiseConf(bias=0.5), gyroscope=NoiseConf(bias=0.01))
    seen = imu_run(conf, 5, episodes=np.arange(400))
    assert (seen[..., :8] == seen[0, :, :8]).all()
    assert seen[0, :, :3].std() == pytest.approx(0.5, rel=0.1)
    assert seen[0, :, 3:6].std() == pytest.approx(0.01, rel=0.1)
    assert abs(np.corrcoef(seen[0, :, 0], seen[0, :, 1])[0, 1]) < 0.15


def test_angles_pass_through_the_half_turn():
    conf = ImuRealismConf(heading=AngleNoiseConf(noise=0.2), tilt=AngleNoiseConf(quantum=0.1))
    truth = np.array([0.0] * 6 + [0.52, -3.14, 3.1], np.float32)
    seen = imu_run(conf, 500, lambda step: truth, episodes=np.arange(4))
    yaw = seen[..., 8].astype(float)
    assert (yaw < -2.5).mean() > 0.2 and (yaw > 2.5).mean() > 0.2
    assert (np.abs(yaw) <= PI32).all()
    off = (yaw - truth[8] + np.pi) % (2 * np.pi) - np.pi
    assert off.std() == pytest.approx(0.2, rel=0.05) and abs(off.mean()) < 0.02
    # The step nearest to -3.14 is -3.1; that nearest to 0.52 is 0.5.
    np.testing.assert_allclose(seen[..., 6:8], np.broadcast_to([0.5, -3.1], (501, 4, 2)), atol=1e-6)


def test_noise_comes_before_the_step_and_the_step_before_the_range():
    conf = SpeedRealismConf(
        forward=NoiseConf(noise=0.4, quantum=0.3), turn=NoiseConf(noise=0.01, quantum=0.3)
    )
    told = speed(50)
    seen = run(Realism(told, conf, 50, STEP_S), told, "velocity", 40, lambda step: [9.9, 0.5], range(50))
    forward, turn = seen[..., 0], seen[..., 1]
    assert forward.dtype == np.float32 and forward.max() == 10.0
    on_step = np.abs(forward / 0.3 - np.rint(forward / 0.3)) < 1e-4
    assert (on_step | (forward == 10.0)).all() and len(np.unique(forward)) > 4
    # Small noise does not reach the next step: had it come after, no two readings would be equal.
    np.testing.assert_allclose(turn, 0.6, atol=1e-6)


def begun(told: ScriptedSensor, faults: NoiseConf) -> dict[str, np.ndarray]:
    sensor = Realism(told, ReadingRealismConf(each=faults), 8, STEP_S)
    begin(sensor, np.ones(8, bool), episode_state(np.arange(8), 0))
    return sensor.read()


def test_bounds_and_types_hold_for_any_reading():
    told = ScriptedSensor({"bytes": limits(200, (3, 2), 10, np.uint8), "line": limits(2.0, (4,))}, 8)
    told.now["bytes"][:] = 100
    seen = begun(told, NoiseConf(noise=90.0, bias=20.0))
    assert seen["bytes"].dtype == np.uint8 and seen["bytes"].shape == (8, 3, 2)
    assert seen["bytes"].min() == 10 and seen["bytes"].max() == 200 and len(np.unique(seen["bytes"])) > 15
    assert seen["line"].dtype == np.float32 and np.abs(seen["line"]).max() == 2.0


def test_bytes_are_the_nearest_not_the_next_lower():
    told = ScriptedSensor({"bytes": limits(255, (400,), 0, np.uint8)}, 8)
    told.now["bytes"][:] = 100
    assert begun(told, NoiseConf(noise=1.0))["bytes"].mean() == pytest.approx(100.0, abs=0.1)


EVERYTHING = ImuRealismConf(
    rate_hz=10.0,
    latency_s=0.1,
    accelerometer=NoiseConf(
        noise_density=0.01, noise=0.1, bias=0.2, bias_instability=0.01, bias_walk=0.1, quantum=0.001
    ),
    heading=AngleNoiseConf(noise=0.1, bias_walk=0.05),
)


def test_an_episode_repeats_itself_wherever_and_whenever_it_is_played():
    def truth(step):
        return np.sin(0.3 * step)

    alone = imu_run(EVERYTHING, 12, truth, episodes=[17])[:, 0]
    together = imu_run(EVERYTHING, 12, truth, episodes=[3, 17, 90])
    assert alone.tobytes() == together[:, 1].tobytes()
    assert not np.array_equal(together[:, 0], together[:, 1])
    # After other episodes, begun while a neighbour goes on, as an environment is restored.
    told = imu(2)
    sensor = Realism(told, EVERYTHING, 2, STEP_S)
    told.now["imu"][:] = truth(0)
    begin(sensor, np.array([True, True]), episode_state([40, 17], 0))
    neighbour = []
    for step in range(1, 8):
        told.now["imu"][:] = truth(step)
        measure(sensor, episode_state([40, 17], step))
        neighbour.append(sensor.read()["imu"][0])
    told.now["imu"][:] = truth(0)
    begin(sensor, np.array([False, True]), episode_state([40, 17], [7, 0]))
    again = [sensor.read()["imu"][1]]
    for step in range(1, 13):
        told.now["imu"][0], told.now["imu"][1] = truth(step + 7), truth(step)
        measure(sensor, episode_state([40, 17], [step + 7, step]))
        again.append(sensor.read()["imu"][1])
        neighbour.append(sensor.read()["imu"][0])
    assert np.array(again).tobytes() == alone.tobytes()
    assert np.array(neighbour).tobytes() == imu_run(EVERYTHING, 19, truth, episodes=[40])[1:, 0].tobytes()
