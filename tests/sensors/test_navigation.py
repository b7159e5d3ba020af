"""With realism, a robot and its controller know faulty readings alone; without, the truth."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import AHEAD, with_boxes
from instruments import ScriptedSensor, limits
from scanning import flat_with
from scenes import STEP_S, about
from sensor_contexts import ScanPair
from sensors_of_rover_zero import lidar_conf
from simulations import rest, started_simulation
from states import begin, group_state, joints_from, measure, motion_of, resting, state_of, write

from dune_rl.env.sensing import sensor_context
from dune_rl.geometry.frames import (
    multiply_quaternions,
    roll_pitch_yaw,
    rotation_from_angles,
    rotation_matrices,
    wrap_angle,
)
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.conf import parse_sensors
from dune_rl.sensors.navigation import Navigation
from dune_rl.sensors.registry import SENSORS
from dune_rl.sensors.suite import SensorSuite
from dune_rl.sensors.wheels import DriveGeometry
from dune_rl.state import GoalState, GroupState
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.batched_worlds import BatchedWorlds

ROWS, WHEELS = 8, 4
CARRIER = SensorCarrier(
    scanner_b=(0.1, 0.0, 0.2),
    camera_b=(0.2, 0.0, 0.3),
    imu_b=(0.0, 0.0, 0.1),
    standing_height_m=0.12,
    num_joints=WHEELS,
    drive=DriveGeometry(0.12, 0.4, (0, 2), (1, 3)),
    vehicle=Unicycle(-1.0, 1.0, 2.0, 2.0, 0.6, 0.4, 0.36),
)
SMALL = {
    "camera": {"width": 12, "height": 8, "outputs": ["rgb", "depth"]},
    "lidar_3d": {"n_rings": 4, "n_beams": 64},
}
# A robot knows its own commands, and here it is alone.
EVERYTHING = [kind for kind in SENSORS.own if kind not in ("last_action", "nearest_agent", "neighbours")]
# These have faults by themselves: whole counts, and slip.
NATURAL = {"encoders", "odometry"}
# Nothing moves here, and no step of the ground is near.
WITHOUT_ANYBODY = {"agent_tracks", "agent_tracks_radial", "agent_tracks_tangential", "low_obstacles"}


def suite(carrier: SensorCarrier = CARRIER, **settings) -> SensorSuite:
    worlds = BatchedWorlds([(with_boxes(AHEAD), WeatherConf())] * ROWS)
    context = sensor_context(worlds, carrier, [], num_rows=ROWS, step_s=STEP_S)
    return SensorSuite(parse_sensors({**SMALL, **settings}), context)


def with_realism(realism: dict[str, object]) -> dict[str, object]:
    """Settings of small sensors with faults, by name."""
    return {name: {**SMALL.get(name, {}), "realism": conf} for name, conf in realism.items()}


def moving(step: int) -> GroupState:
    """Robots that drive and turn on a slope, each at a place of its own, with goals around them."""
    rng = np.random.default_rng(4)
    bodies = np.zeros((ROWS, 13))
    bodies[:, :2] = rng.uniform(-2.0, 2.0, (ROWS, 2)) + 0.02 * step
    bodies[:, 2] = 0.12
    turn = [rotation_from_angles(np.array([0.05, -0.1, 0.7 * row + 0.03 * step])) for row in range(ROWS)]
    bodies[:, 3:7] = [quaternion(each) for each in turn]
    bodies[:, 7:] = rng.normal(0.0, 0.5, (ROWS, 6))
    angle, speed = 0.3 * step + np.arange(WHEELS), np.full(WHEELS, 6.0)
    joints = joints_from(np.tile(np.concatenate([angle, speed, np.full(WHEELS, 0.5)]), (ROWS, 1)))
    motion = motion_of(bodies, joints)
    goals = rng.uniform(-9.0, 9.0, (ROWS, 2))
    offset = goals - motion.position_w[:, :2]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - motion.yaw)
    goal = GoalState(goals, distance, distance, bearing)
    return group_state(motion, steps=step, goal=goal, seed=2)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    roll, pitch, yaw = roll_pitch_yaw(rotation)
    tilted = multiply_quaternions(about([0, 1, 0], pitch), about([1, 0, 0], roll))
    return multiply_quaternions(about([0, 0, 1], yaw), tilted)


def driven(sensors: SensorSuite, steps: int = 4) -> dict[str, np.ndarray]:
    for step in range(steps):
        now = moving(step)
        if step == 0:
            sensors.begin(np.ones(ROWS, bool), now, state_of(now))
        else:
            sensors.measure(now, state_of(now))
    return sensors.observe()


# -- what is perfect, and what is not ------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("realism", [{"imu": "bno055"}, {"lidar": "rplidar_a2m8"}, {"odometry": {}}])
def test_once_any_realism_is_set_no_reading_is_the_truth(realism):
    true = driven(suite(enabled=EVERYTHING))
    seen = driven(suite(enabled=EVERYTHING, **with_realism(realism)))
    assert list(seen) == list(true)
    for name in set(true) - NATURAL - WITHOUT_ANYBODY:
        assert (seen[name] != true[name]).any(), name


def test_without_realism_all_is_true():
    sensors = suite(enabled=("goal", "velocity", "imu"))
    seen, now = driven(sensors), moving(3)
    np.testing.assert_array_equal(seen["goal"], np.float32([now.goal.distance, now.goal.bearing]).T)
    np.testing.assert_array_equal(seen["velocity"][:, 0], np.float32(now.motion.velocity_b[:, 0]))
    np.testing.assert_array_equal(seen["imu"][:, 6:], np.float32(now.motion.roll_pitch_yaw))
    assert sensors.navigation is None
    assert sensors.controller_motion(now) is now.motion


def test_what_is_set_perfect_stays_so():
    enabled = ("lidar", "imu", "camera")
    true = driven(suite(enabled=enabled))
    seen = driven(suite(enabled=enabled, **with_realism({"imu": "mpu6050", "lidar": "perfect"})))
    np.testing.assert_array_equal(seen["lidar"], true["lidar"])
    assert (seen["imu"] != true["imu"]).any() and (seen["camera_rgb"] != true["camera_rgb"]).any()


def test_a_named_sensor_s_realism_counts():
    named = {"rear": {"sensor": "camera", "realism": "raspberry_pi_v2", "width": 8, "height": 6}}
    sensors = suite(enabled=("rear", "goal"), **named)
    assert sensors.navigation is not None
    assert (driven(sensors)["goal"] != driven(suite(enabled=("goal",)))["goal"]).any()


@pytest.mark.parametrize("control_hz", [10.0, 20.0, 30.0, 50.0, 100.0])
def test_default_parts_fit_any_control_rate(control_hz):
    devices = {kind: SENSORS.settings_class(kind).default_realism for kind in SENSORS.own}
    assert all(devices[kind] is not None for kind in ("imu", "lidar", "camera", "position"))
    for device in devices.values():
        assert device is None or device.fit_to(1.0 / control_hz).steps(1.0 / control_hz)


# -- derived channels ----------------------------------------------------------------------------------

FAULTY = {
    "imu": {"gyroscope": {"bias": 0.2, "noise": 0.05}, "tilt": {"bias": 0.1}, "heading": {"bias": 0.3}},
    "position": {"place": {"bias": 0.5, "noise": 0.1}, "rate_hz": 10},
    "odometry": {"forward": {"bias": 0.2}},
}
SHOWN = ("imu", "position", "odometry", "velocity", "goal")


def test_goal_and_velocity_follow_from_the_other_readings():
    sensors = suite(enabled=SHOWN, **with_realism(FAULTY))
    seen, now = driven(sensors), moving(3)
    np.testing.assert_array_equal(seen["velocity"], np.stack([seen["odometry"][:, 3], seen["imu"][:, 5]], 1))
    offset = now.goal.position_w - seen["position"][:, :2]
    np.testing.assert_allclose(seen["goal"][:, 0], np.hypot(offset[:, 0], offset[:, 1]), rtol=1e-5)
    expected = np.arctan2(offset[:, 1], offset[:, 0]) - seen["imu"][:, 8]
    np.testing.assert_allclose(wrap_angle(seen["goal"][:, 1] - expected), 0.0, atol=1e-5)
    for name, reading in seen.items():
        low, high = sensors.bounds[name]
        assert (low <= reading).all() and (reading <= high).all(), name


def test_the_controller_knows_what_the_instruments_read():
    sensors = suite(enabled=SHOWN, **with_realism(FAULTY))
    seen, now = driven(sensors), moving(3)
    known = sensors.controller_motion(now)
    np.testing.assert_array_equal(known.angular_b, seen["imu"][:, 3:6])
    np.testing.assert_array_equal(known.roll_pitch_yaw, seen["imu"][:, 6:9])
    np.testing.assert_array_equal(known.velocity_b[:, 0], seen["odometry"][:, 3])
    assert not known.velocity_b[:, 1:].any()
    # It is so whether they are observed or not.
    hidden = suite(enabled=("lidar",), **with_realism(FAULTY))
    driven(hidden)
    np.testing.assert_array_equal(hidden.controller_motion(now).angular_b, known.angular_b)
    assert hidden.needs_joints


def test_a_velocity_with_faults_of_its_own_has_those():
    sensors = suite(enabled=("velocity",), velocity={"realism": {"forward": {"quantum": 0.25}}})
    seen, now = driven(sensors), moving(3)
    expected = np.rint(now.motion.velocity_b[:, 0] / 0.25) * 0.25
    np.testing.assert_allclose(seen["velocity"][:, 0], expected, atol=1e-6)
    np.testing.assert_allclose(sensors.controller_motion(now).velocity_b[:, 0], expected, atol=1e-6)


def test_without_wheels_the_speed_is_that_of_the_legs():
    sensors = suite(replace(CARRIER, drive=None), enabled=("velocity", "imu"), imu={"realism": "perfect"})
    seen, now = driven(sensors), moving(3)
    off = seen["velocity"][:, 0] - now.motion.velocity_b[:, 0]
    assert 0.0 < np.abs(off).max() < 0.3
    np.testing.assert_array_equal(seen["velocity"][:, 1], seen["imu"][:, 5])
    assert not sensors.needs_joints


def test_a_sensor_that_takes_the_name_of_an_instrument_leaves_it_alone():
    named = {"velocity": {"sensor": "planar_velocity", "realism": "perfect"}}
    sensors = suite(enabled=("velocity", "imu"), **named, imu={"realism": "perfect"})
    seen, now = driven(sensors), moving(3)
    assert "velocity" in sensors.navigation.instruments
    yaw = now.motion.yaw
    ahead = np.cos(yaw) * now.motion.velocity_w[:, 0] + np.sin(yaw) * now.motion.velocity_w[:, 1]
    np.testing.assert_allclose(seen["velocity"][:, 0], ahead, rtol=1e-4, atol=1e-6)


def test_a_planar_velocity_is_that_of_the_wheels_along_the_heading():
    sensors = suite(enabled=("planar_velocity", "odometry", "imu"), imu={"realism": "perfect"})
    seen = driven(sensors)
    ahead = seen["odometry"][:, 3] * np.cos(seen["imu"][:, 7])
    np.testing.assert_allclose(seen["planar_velocity"], np.stack([ahead, 0 * ahead], axis=1), atol=1e-6)


def test_a_height_scan_is_read_where_the_robot_believes_to_be():
    realism = {"position": {"height": {"bias": 0.1}}, "height_scan": {}, "imu": "perfect"}
    true = driven(suite(enabled=("height_scan",)))["height_scan"]
    own = driven(suite(enabled=("height_scan", "position"), **with_realism(realism)))["height_scan"]
    np.testing.assert_array_equal(own, true)
    del realism["height_scan"]
    seen = driven(suite(enabled=("height_scan", "position"), **with_realism(realism)))
    error = seen["position"][:, 2] - moving(3).motion.position_w[:, 2]
    assert 0.05 < np.abs(error).max() < 0.5
    np.testing.assert_allclose(np.median(seen["height_scan"] - true, axis=1), -error, atol=0.02)


# -- dead reckoning ------------------------------------------------------------------------------------


def scripted(rows: int) -> tuple[Navigation, ScriptedSensor, ScriptedSensor]:
    imu = ScriptedSensor({"imu": limits([100.0] * 9)}, rows)
    velocity = ScriptedSensor({"velocity": limits([10.0, 10.0])}, rows)
    return Navigation({"imu": imu, "velocity": velocity}, rows, STEP_S), imu, velocity


def test_angles_and_rotations_agree():
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(200, 4))
    rotations = rotation_matrices(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    np.testing.assert_allclose(rotation_from_angles(roll_pitch_yaw(rotations)), rotations, atol=1e-12)


def test_a_circle_closes_by_readings_alone():
    speed, rate, steps = 1.0, 0.4, 314
    navigation, imu, velocity = scripted(2)
    velocity.now["velocity"][:, 0] = speed
    begin(navigation, np.ones(2, bool), group_state(resting(2)))
    for step in range(1, steps + 1):
        imu.now["imu"][:, 8] = wrap_angle(np.array([rate, -rate]) * step * STEP_S)
        measure(navigation, group_state(resting(2), steps=step))
        angle, radius = rate * step * STEP_S, speed / rate
        expected = [[radius * np.sin(angle), side * radius * (1 - np.cos(angle)), 0.0] for side in (1, -1)]
        np.testing.assert_allclose(navigation.position_w, expected, atol=2e-3)


def test_uphill_it_climbs_and_an_episode_begins_at_the_origin():
    navigation, imu, velocity = scripted(2)
    velocity.now["velocity"][:, 0] = 2.0
    imu.now["imu"][:, 7] = -0.3
    begin(navigation, np.ones(2, bool), group_state(resting(2)))
    for step in range(20):
        measure(navigation, group_state(resting(2), steps=step + 1))
    np.testing.assert_allclose(
        navigation.position_w, [[2 * np.cos(0.3), 0.0, 2 * np.sin(0.3)]] * 2, atol=1e-6
    )
    begin(navigation, np.array([True, False]), group_state(resting(2)))
    assert not navigation.position_w[0].any() and navigation.position_w[1].any()


@pytest.mark.parametrize("segments", [1, 5, -3])
def test_a_past_scan_is_carried_by_what_the_robot_believes(segments):
    walls = flat_with((4.0, 0.0, 0.0, 0.2, 3.0), (-2.0, 3.0, 0.3, 2.0, 0.2), (0.0, -5.0, 0.0, 1.0, 0.2))
    navigation, imu, _ = scripted(1)
    sensor = ScanPair(walls, lidar_conf(mount_b=(0.0, 0.0, 0.2)), navigation=navigation)
    standing = resting(1)
    write(standing.position_w, (slice(None), 2), 0.125)
    begin(navigation, np.ones(1, bool), group_state(standing))
    begin(sensor, np.ones(1, bool), group_state(standing))
    for step in (1, 2):
        # The robot stands still and believes to turn: two steps, half of the turn each.
        imu.now["imu"][:, 8] = wrap_angle(np.array(segments * 2 * np.pi / 32 * step / 2))
        now = group_state(standing, steps=step)
        measure(navigation, now)
        measure(sensor, now)
    seen = sensor.read()
    expected = np.roll(seen["lidar"], -segments, axis=1)
    assert (np.abs(seen["lidar_past"] - expected) < 1e-3).mean() > 0.9
    assert (np.abs(seen["lidar_past"] - seen["lidar"]) < 1e-3).mean() < 0.8


# -- in a simulation -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_biased_gyroscope_misleads_the_heading_loop():
    # Rovers told to go straight on: a loop that closes on the yaw rate turns against the gyroscope's bias.
    faulty = with_realism({"imu": {"gyroscope": {"bias": 0.3}}, "lidar": "perfect"})
    turns = {}
    for name, sensors in (("perfect", {"enabled": ["imu"]}), ("faulty", {"enabled": ["imu"], **faulty})):
        scenes = started_simulation("flat", 16, sensors=sensors)
        group = scenes.state.groups["rover"]
        bias = scenes.observe()["imu"][:, 0, 5] - group.motion.angular_b[:, 2]
        start = group.motion.yaw.copy()
        actions = rest(scenes)
        actions["rover"][..., 0] = 0.5
        for _ in range(60):
            scenes.step(actions)
        turns[name] = wrap_angle(scenes.state.groups["rover"].motion.yaw - start)
        scenes.close()
    assert np.abs(turns["perfect"]).max() < 0.1
    assert np.corrcoef(bias, turns["faulty"])[0, 1] < -0.9
    assert turns["faulty"].std() > 0.3


@pytest.mark.slow
def test_a_goal_is_known_as_well_as_the_receiver_is():
    # Two metres of deviation on each axis; eight episodes of sixteen scenes.
    realism = {"position": {"place": {"bias": 2.0}}, "imu": "perfect"}
    off = []
    scenes = started_simulation(
        "flat", 16, sensors={"enabled": ["goal", "position"], **with_realism(realism)}
    )
    for _ in range(8):
        now, seen = scenes.state.groups["rover"], scenes.observe()
        away = now.goal.position_w - now.motion.position_w[:, :2]
        unit = away / np.linalg.norm(away, axis=1, keepdims=True)
        error = seen["position"][:, 0, :2] - now.motion.position_w[:, :2]
        off.append(seen["goal"][:, 0, 0] - now.goal.distance)
        far = now.goal.distance > 10.0
        np.testing.assert_allclose(off[-1][far], -(error * unit).sum(axis=1)[far], atol=2.0)
        scenes.reset()
    scenes.close()
    assert np.concatenate(off).std() == pytest.approx(2.0, rel=0.25)


def test_others_are_where_they_are_from_where_the_robot_believes_to_be():
    realism = {
        "position": {"place": {"bias": 1.0}},
        "imu": {"heading_from": "magnetometer", "heading": {"bias": 0.3}},
    }
    enabled = ["nearest_agent", "neighbours", "position", "imu"]
    scenes = started_simulation(
        "flat", 8, actors="walkers", sensors={"enabled": enabled, **with_realism(realism)}
    )
    seen = {name: values[:, 0] for name, values in scenes.observe().items()}
    walkers = scenes.state.groups["walker"].motion.position_w.reshape(8, 2, 3)[..., :2]
    offset = walkers - seen["position"][:, None, :2]
    nearest = np.hypot(*np.moveaxis(offset, -1, 0)).argmin(axis=1)
    x, y = offset[np.arange(8), nearest].T
    yaw = seen["imu"][:, 8]
    ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    # Beside the noise of 0.05 that these sensors have of their own.
    np.testing.assert_allclose(seen["nearest_agent"][:, 0], np.hypot(x, y), atol=0.25)
    bearing = wrap_angle(seen["nearest_agent"][:, 1] - np.arctan2(left, ahead))
    np.testing.assert_allclose(bearing, 0.0, atol=0.25)
    near = seen["neighbours"][:, 0] > 0.5
    assert near.any()
    np.testing.assert_allclose(
        seen["neighbours"][near, 1:3], np.stack([ahead, left], axis=1)[near], atol=0.25
    )
    now = scenes.state.groups["rover"].motion
    assert np.abs(seen["position"][:, :2] - now.position_w[:, :2]).max() > 0.5
    assert np.abs(wrap_angle(yaw - now.yaw)).max() > 0.2
    scenes.close()
