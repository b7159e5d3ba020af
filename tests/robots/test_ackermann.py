"""Ackermann steering: its geometry by formula, and cars and rocker-bogies that drive, on both engines."""

import re

import numpy as np
import pytest
from rollouts import digest_of
from scenes import STEP_S, Drive, box, every_backend, plane
from simulations import act, motion_of_group, observation
from vehicles import (
    CAR_KINGPIN_M,
    CAR_LIMIT_RAD,
    CAR_RADIUS_M,
    CAR_TRACK_M,
    CAR_WHEELBASE_M,
    ROCKER_TRACK_M,
    ROCKER_WHEELS_X,
    box_link,
    rolling,
    small_link,
    steering,
    transmission,
    wheel_link,
    write,
    write_car,
    write_rocker_bogie,
)

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import RobotError
from dune_rl.geometry.frames import wrap_angle
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.robot import UrdfRobot

# Of the middle of the rear axle, by the inner wheel's limit at its kingpin.
CAR_RADIUS_OF_TURN_M = CAR_WHEELBASE_M / np.tan(CAR_LIMIT_RAD) + CAR_TRACK_M / 2 - CAR_KINGPIN_M


def read(path, **settings):
    return UrdfRobot(UrdfConf(path=str(path), **settings), 1)


def drive(robot, backend, position_w=(0.0, 0.0)):
    return Drive(backend, rover=robot, position_w=(*position_w, robot.description.standing_height_m + 0.003))


def commands(robot, speed, heading, steps):
    for _ in range(steps):
        found = robot.wheel_commands(np.array([[speed, heading]]), np.zeros(1), STEP_S)
    return found[0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -1"])
def test_all_axles_meet_in_the_turning_centre(tmp_path, side, axis):
    robot = read(write_car(tmp_path, axis=axis))
    geometry = robot.steering.geometry
    radius = 1.7
    left, right = geometry.steering_angles(np.array([side / radius]))[0] * (1 if axis == "0 0 1" else -1)
    kingpin = CAR_TRACK_M / 2 - CAR_KINGPIN_M
    # The turning centre lies on the rear axle, at y = side * radius.
    assert left == pytest.approx(np.arctan(CAR_WHEELBASE_M / (side * radius - kingpin)))
    assert right == pytest.approx(np.arctan(CAR_WHEELBASE_M / (side * radius + kingpin)))
    # The outer rear wheel goes farther than the inner one, by their distances from the centre.
    ratios = geometry.speed_ratios(np.array([side / radius]))[0]
    distances = np.array([radius - side * CAR_TRACK_M / 2, radius + side * CAR_TRACK_M / 2])
    np.testing.assert_allclose(ratios, distances / radius)


def test_wheels_that_steer_and_drive_go_as_fast_as_their_distance_from_the_centre(tmp_path):
    robot = read(write_rocker_bogie(tmp_path, corners_steer=True))
    geometry = robot.steering.geometry
    ratios = geometry.speed_ratios(np.array([0.8]))[0]
    for wheel, ratio in zip(robot.body.ground_links, ratios, strict=True):
        x = ROCKER_WHEELS_X[("front", "middle", "rear").index(wheel.split("_")[1])]
        y = ROCKER_TRACK_M / 2 * (1 if "left" in wheel else -1)
        assert ratio == pytest.approx(0.8 * np.hypot(x, 1 / 0.8 - y))
    # Rear corners steer against the front ones.
    angles = geometry.steering_angles(np.array([0.8]))[0]
    by_name = dict(zip((motor.joint for motor in robot.body.motors[6:]), angles, strict=True))
    assert by_name["left_front_corner_joint"] == pytest.approx(-by_name["left_rear_corner_joint"])
    assert by_name["left_front_corner_joint"] > by_name["right_front_corner_joint"] > 0.0


@pytest.mark.parametrize("curvature", [-0.9, -0.2, 0.1, 0.9])
def test_curvature_and_motion_are_measured_as_they_are_made(tmp_path, curvature):
    for path in (write_car(tmp_path), write_rocker_bogie(tmp_path, corners_steer=True)):
        geometry = read(path).steering.geometry
        bent = np.array([curvature, curvature])
        angles = geometry.steering_angles(bent)
        np.testing.assert_allclose(geometry.curvature(angles), bent)
        ahead = np.array([0.3, -0.2])
        turned = ahead[:, None] * geometry.speed_ratios(bent) / geometry.wheel_radius_m
        motion = geometry.motion(turned, np.concatenate([turned, angles], axis=1))
        np.testing.assert_allclose(motion, np.stack([ahead, ahead * curvature], axis=1))


def test_what_a_car_has_is_derived(tmp_path):
    robot = read(write_car(tmp_path))
    assert robot.steering.turning_radius_m == pytest.approx(CAR_RADIUS_OF_TURN_M)
    assert robot.body.drive_joints == (
        "rear_left_wheel_joint",
        "rear_right_wheel_joint",
        "left_knuckle_joint",
        "right_knuckle_joint",
    )
    assert [motor.mode for motor in robot.body.motors] == ["velocity"] * 2 + ["position"] * 2
    assert len(robot.description.contact_centres_b) == len(robot.body.ground_links) == 4
    text = robot.summary()
    assert "drive: Ackermann steering: left_knuckle_joint, right_knuckle_joint steer" in text
    assert f"smallest circle: radius {CAR_RADIUS_OF_TURN_M:.2f} m about x = 0.000 m" in text
    assert "wheels without motor: front_left_wheel_joint, front_right_wheel_joint" in text
    assert "assumed (the URDF has no effort limit)" in text


def test_driven_wheels_are_those_that_controllers_command_or_that_are_named(tmp_path):
    front = ["front_left_wheel_joint", "front_right_wheel_joint"]
    pivots = ["left_knuckle_joint", "right_knuckle_joint"]
    told = read(write_car(tmp_path, *map(transmission, [*front, *pivots])))
    assert list(told.body.drive_joints) == [*front, *pivots]
    named = read(write_car(tmp_path), left_wheels=(front[0],), right_wheels=(front[1],))
    assert list(named.body.drive_joints) == [*front, *pivots]
    # Kingpins are inward of the wheels: in a curve the inner one goes less far by that.
    ratios = named.steering.geometry.speed_ratios(np.array([0.5]))[0]
    kingpin = CAR_TRACK_M / 2 - CAR_KINGPIN_M
    far = np.hypot(CAR_WHEELBASE_M, 2.0 - kingpin) - CAR_KINGPIN_M
    assert ratios[0] == pytest.approx(0.5 * far)


def test_settings_override_what_is_found(tmp_path):
    path = write_car(tmp_path)
    skid = read(path, drive={"kind": "skid_steer"})
    assert skid.steering is None and len(skid.body.drive_joints) == 4
    assert "left_knuckle_joint, right_knuckle_joint are fixed at zero" in skid.summary()
    narrow = read(path, drive={"max_steering_deg": 10.0, "max_steering_rate_radps": 0.5})
    assert narrow.steering.turning_radius_m == pytest.approx(
        CAR_WHEELBASE_M / np.tan(np.deg2rad(10.0)) + CAR_TRACK_M / 2 - CAR_KINGPIN_M
    )
    assert narrow.body.motors[-1].max_speed_radps == 0.5
    with pytest.raises(
        RobotError, match=r"robot\.drive\.kind=ackermann: rocker_bogie\.urdf has no joint that"
    ):
        read(write_rocker_bogie(tmp_path, corners_steer=False), drive={"kind": "ackermann"})
    with pytest.raises(RobotError, match=r"robot\.steering_joints: joint rear_left_wheel_joint of car\.urdf"):
        read(path, steering_joints=("rear_left_wheel_joint",))
    with pytest.raises(RobotError, match=r"robot\.steering_joints: car\.urdf has no joint wheel"):
        read(path, steering_joints=("wheel",))


def test_a_joint_about_z_without_a_wheel_does_not_steer(tmp_path):
    extra = small_link("turret"), steering("turret", "base_link", (0.0, 0.0, 0.2), 1.0)
    assert "turret_joint" not in read(write_car(tmp_path, *extra)).body.drive_joints


@pytest.mark.parametrize("limits", [(0, 0), (0, 0.5), (0.1, 0.5), (-0.6, 0)])
def test_named_joints_that_cannot_steer_to_both_sides_are_refused(tmp_path, limits):
    path = write_car(tmp_path, limit_rad=0.6)
    new = 'lower="{}" upper="{}"'.format(*limits)
    path.write_text(path.read_text().replace('lower="-0.6" upper="0.6"', new))
    with pytest.raises(RobotError, match=r"car\.urdf: left_knuckle_joint, .* cannot steer to both sides"):
        read(path, steering_joints=("left_knuckle_joint", "right_knuckle_joint"))


def test_an_axle_that_steers_alone_is_refused(tmp_path):
    elements = [box_link("base_link", 20.0, (0.7, 0.36, 0.12), "0 0 0.1")]
    for side, y in (("left", 0.25), ("right", -0.25)):
        knuckle, wheel = f"{side}_knuckle", f"{side}_wheel"
        elements += [small_link(knuckle), steering(knuckle, "base_link", (0.0, y, 0.0), 0.6)]
        elements += [wheel_link(wheel, 1.0, 0.12, 0.06), rolling(wheel, knuckle, (0.0, 0.0, 0.0))]
    path = write(tmp_path, "axle", *elements)
    with pytest.raises(RobotError, match="none is before or behind the axle"):
        read(path)
    assert read(path, drive={"kind": "skid_steer"}).steering is None


def test_it_stands_where_no_speed_and_no_heading_are_commanded(tmp_path):
    robot = read(write_car(tmp_path))
    np.testing.assert_allclose(commands(robot, 0.0, 0.0, 10), 0.0, atol=1e-12)


def test_a_heading_without_speed_is_an_arc_forward_and_one_behind_keeps_the_direction(tmp_path):
    robot = read(write_car(tmp_path))
    arc = commands(robot, 0.0, 1.0, 40)
    # A quarter of the top speed, on the smallest circle.
    assert arc[:2].mean() * CAR_RADIUS_M == pytest.approx(0.25)
    assert max(arc[2:]) == pytest.approx(CAR_LIMIT_RAD)
    for speed in (0.6, -0.6):
        robot.reset(np.array([True]))
        turning = commands(robot, speed, 3.0, 40)
        assert turning[:2].mean() * CAR_RADIUS_M == pytest.approx(speed)
        # In reverse it steers to the right to turn to the left.
        assert np.abs(turning[2:]).max() == pytest.approx(CAR_LIMIT_RAD)
        assert (np.sign(turning[2:]) == np.sign(speed)).all()


def test_robots_are_commanded_independently(tmp_path):
    path = write_car(tmp_path)
    both = UrdfRobot(UrdfConf(path=str(path)), 2)
    rng = np.random.default_rng(0)
    actions = rng.uniform([-1.0, -3.0], [1.0, 3.0], (30, 2, 2))
    for row in range(2):
        both.reset(np.array([True, True]))
        alone = read(path)
        for action in actions:
            together = both.wheel_commands(action, np.zeros(2), STEP_S)
            single = alone.wheel_commands(action[row : row + 1], np.zeros(1), STEP_S)
            np.testing.assert_allclose(together[row], single[0], atol=1e-12)


@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("six_wheels", [False, True])
def test_it_drives_straight_and_on_circles_of_the_radius_that_follows(backend, six_wheels, tmp_path):
    robot = read(
        write_rocker_bogie(tmp_path, corners_steer=True) if six_wheels else write_car(tmp_path),
    )
    driven = drive(robot, backend)
    for _ in range(40):
        driven.step(0.5, 0.0)
    assert driven.stage.velocity[0] == pytest.approx(0.5, rel=0.05)
    assert abs(driven.stage.position[1]) < 0.02
    path, yaws = [], []
    for _ in range(160):
        driven.step(0.5, 3.0)
        path.append(driven.stage.position[:2])
        yaws.append(driven.stage.yaw)
    turned = np.unwrap(yaws)[-1] - np.unwrap(yaws)[60]
    travelled = np.linalg.norm(np.diff(path[60:], axis=0), axis=1).sum()
    assert travelled == pytest.approx(0.5 * 99 * STEP_S, rel=0.05)
    assert travelled / turned == pytest.approx(robot.steering.turning_radius_m, rel=0.05)


@every_backend
def test_frames_of_links_may_be_turned(backend, tmp_path):
    # The knuckles' frames are pitched by 0.3 rad, which their axes and the wheels' frames undo.
    path = write_car(tmp_path)
    text, axis = path.read_text(), f"{-np.sin(0.3)} 0 {np.cos(0.3)}"
    for side in ("left", "right"):
        text = re.sub(
            rf'(<joint name="{side}_knuckle_joint".*?<origin xyz="[^"]*")/><axis xyz="0 0 1"/>',
            rf'\1 rpy="0 0.3 0"/><axis xyz="{axis}"/>',
            text,
        )
        text = re.sub(
            rf'(<joint name="front_{side}_wheel_joint".*?<origin xyz="[^"]*")/>',
            r'\1 rpy="0 -0.3 0"/>',
            text,
        )
    path.write_text(text)
    robot = read(path)
    assert robot.steering.turning_radius_m == pytest.approx(CAR_RADIUS_OF_TURN_M)
    driven = drive(robot, backend)
    for _ in range(80):
        driven.step(0.5, 3.0)
    start = driven.stage.yaw
    for _ in range(40):
        driven.step(0.5, 3.0)
    turned = wrap_angle(np.array(driven.stage.yaw - start))
    assert turned == pytest.approx(0.5 * 40 * STEP_S / CAR_RADIUS_OF_TURN_M, rel=0.05)
    # It neither sinks nor leans.
    assert driven.stage.rotation[2, 2] > 0.999
    assert driven.stage.position[2] == pytest.approx(CAR_RADIUS_M, abs=0.005)


@every_backend
def test_it_turns_to_a_heading_forward_and_in_reverse(backend, tmp_path):
    robot = read(write_car(tmp_path))
    for speed in (0.5, -0.5):
        driven = drive(robot, backend)
        for _ in range(140):
            driven.step(speed, float(wrap_angle(np.array(1.5 - driven.stage.yaw))))
        assert driven.stage.yaw == pytest.approx(1.5, abs=0.03)
        heading = np.array([np.cos(driven.stage.yaw), np.sin(driven.stage.yaw), 0.0])
        assert driven.stage.velocity @ heading == pytest.approx(speed, rel=0.05)


@every_backend
def test_a_rocker_bogie_climbs_a_step_with_one_side_and_stays_nearly_level(backend, tmp_path):
    robot = read(write_rocker_bogie(tmp_path, corners_steer=True))
    step = box((1.5, ROCKER_TRACK_M / 2), 1.0, 0.4, 0.06, drivable=True)
    driven = Drive(
        backend,
        rover=robot,
        statics=[plane(), step],
        position_w=(0.0, 0.0, robot.description.standing_height_m + 0.003),
    )
    heights, rockers = [], []
    for _ in range(110):
        driven.step(0.4, float(-driven.stage.yaw))
        heights.append(driven.stage.position[2])
        rockers.append(driven.stage.engine.joint_angles(["left_rocker_joint", "right_rocker_joint"]))
    assert driven.stage.position[0] > 1.5
    assert max(heights) - heights[0] > 0.015
    rockers = np.array(rockers)
    # The differential turns them opposite to each other.
    assert np.abs(rockers[:, 0]).max() > 0.03
    np.testing.assert_allclose(rockers.sum(axis=1), 0.0, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["bullet", "dart"])
def test_it_drives_to_its_goal_with_sensors_of_wheels_and_all_that_is_randomised(engine, tmp_path):
    path = write_car(tmp_path)
    conf = compose_environment(
        "inspection",
        [
            "actors=none",
            # Soft ground resists wheels with and without motors.
            "world.surfaces=natural",
            "robot=urdf",
            f"robot.path={path}",
            f"physics={engine}",
            "sensors.enabled=[goal,encoders,odometry,currents,imu]",
            "randomisation=everything",
            "randomisation.world_seed=null",
        ],
    )
    simulation = make_simulation(conf, 2, 0)
    simulation.reset()
    for _ in range(40):
        goal = observation(simulation)["goal"]
        act(simulation, np.stack([np.full(2, 0.6), goal[:, 1]], axis=1))
    seen = observation(simulation)
    assert seen["encoders"].shape == (2, 4) and seen["currents"].shape == (2, 2)
    assert np.isfinite(seen["odometry"]).all()
    assert (seen["odometry"][:, 3] > 0.2).all()
    simulation.close()


@pytest.mark.parametrize("engine", ["bullet", "dart"])
def test_odometry_follows_a_curve_by_wheels_and_steering(engine, tmp_path):
    conf = compose_environment(
        "flat",
        [
            "actors=none",
            "robot=urdf",
            f"robot.path={write_car(tmp_path)}",
            f"physics={engine}",
            "sensors.enabled=[odometry]",
            "sensors.encoders.counts_per_turn=0",
        ],
    )
    simulation = make_simulation(conf, 1, 0)
    simulation.reset()
    start = _pose(simulation)
    for step in range(80):
        act(simulation, [[0.5, 0.6 if step < 40 else -0.6]])
    end, told = _pose(simulation), observation(simulation)["odometry"][0]
    c, s = np.cos(start[2]), np.sin(start[2])
    moved = np.array([[c, s], [-s, c]]) @ (end - start)[:2]
    np.testing.assert_allclose(told[:2], moved, atol=0.06)
    assert told[2] == pytest.approx(wrap_angle(end - start)[2], abs=0.05)
    simulation.close()


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["bullet", "dart"])
def test_the_same_seed_gives_the_same_bytes_again(engine, tmp_path):
    path = write_rocker_bogie(tmp_path, corners_steer=True)
    words = ["actors=none", "robot=urdf", f"robot.path={path}", f"physics={engine}"]
    conf = compose_environment("flat", [*words, "task.terminations.time_limit.max_steps=20"])
    digests = []
    for _ in range(2):
        simulation = make_simulation(conf, 2, 0)
        digests.append(digest_of(simulation, 50))
        simulation.close()
    assert digests[0] == digests[1]


def _pose(simulation):
    motion = motion_of_group(simulation)
    return np.array([*motion.position_w[0, :2], motion.yaw[0]])
