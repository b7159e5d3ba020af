"""The rover under commands: it tracks them, keeps its limits, and forgets."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import (
    GRAVITY_MPS2,
    HULL_HALF_LENGTH_M,
    MASS_KG,
    STEP_S,
    WHEEL_RADIUS_M,
    Drive,
    allowed,
    box,
    every_backend,
    plane,
    quaternion_of,
)

from dune_rl.geometry.frames import rotation_matrices, wrap_angle
from dune_rl.physics.robot_body import BodyVariation
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf, RoverZeroDriveConf
from dune_rl.robots.wheeled import SkidSteerConf, SkidSteerDrive

EIGHT_HEADINGS = [pytest.param(k * np.pi / 4, id=f"{45 * k}deg") for k in range(8)]
KP = HeadingConf().kp
ALL = np.array([True])


# -- in physics ------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["1.0-*", "2.0-45deg-*"])
@every_backend
@pytest.mark.parametrize("yaw", EIGHT_HEADINGS)
@pytest.mark.parametrize("rate", [0.3, 1.0, 2.0])
def test_turning_on_the_spot_is_as_fast_as_commanded(backend, yaw, rate):
    drive = Drive(backend, yaw=yaw)
    yaws = []
    for _ in range(40):
        drive.step(0.0, rate / KP)
        yaws.append(drive.stage.yaw)
    yaws = np.unwrap(yaws)
    assert (yaws[39] - yaws[9]) / 1.5 == pytest.approx(rate, rel=0.1)
    assert np.linalg.norm(drive.stage.position[:2]) < 0.1


@pytest.mark.slow(all_but=["0deg-*", "135deg-*"])
@every_backend
@pytest.mark.parametrize("yaw", EIGHT_HEADINGS)
def test_ten_metres_straight(backend, yaw):
    drive = Drive(backend, yaw=yaw)
    track = [drive.stage.position[:2]]
    while np.linalg.norm(track[-1] - track[0]) < 10.0 and len(track) < 300:
        drive.step(0.8, 0.0)
        track.append(drive.stage.position[:2])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    offset = np.array(track) - track[0]
    assert offset[-1] @ ahead > 9.9
    assert np.abs(offset @ left).max() < 0.1
    speed = (offset[-1] - offset[20]) @ ahead / ((len(track) - 21) * STEP_S)
    assert speed == pytest.approx(0.8, rel=0.05)


@every_backend
def test_a_curve_has_the_radius_v_over_omega(backend):
    drive = Drive(backend)
    speed, rate = 0.6, 0.5
    for _ in range(20):
        drive.step(speed, rate / KP)
    track = []
    for _ in range(round(2 * np.pi / rate / STEP_S)):
        track.append(drive.stage.position[:2])
        drive.step(speed, rate / KP)
    width, height = np.ptp(track, axis=0)
    assert width / 2 == pytest.approx(speed / rate, rel=0.1)
    assert height / 2 == pytest.approx(speed / rate, rel=0.1)


@every_backend
@pytest.mark.parametrize("speed", [0.0, 0.8])
@pytest.mark.parametrize("target", [0.5, np.pi / 2, 2.5, -3.0])
def test_the_controller_reaches_a_heading_without_overshoot(backend, target, speed):
    drive = Drive(backend)
    yaws = []
    for _ in range(80):
        drive.step(speed, float(wrap_angle(np.asarray(target - drive.stage.yaw))))
        yaws.append(drive.stage.yaw)
    travelled = np.unwrap(yaws) * np.sign(target)
    assert travelled[-1] == pytest.approx(abs(target), abs=0.02)
    assert travelled.max() < abs(target) + 0.03


@every_backend
@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_speed_keeps_its_limit_and_grows_no_faster_than_it_may(backend, speed):
    drive = Drive(backend)
    speeds = [0.0]
    for _ in range(40):
        drive.step(speed, 0.0)
        speeds.append(drive.stage.velocity[0] * np.sign(speed))
    # A body that rocks on its tyres as it starts is for a moment faster than they are.
    assert max(speeds) < allowed(backend, 1.02, 1.06)
    assert speeds[-1] == pytest.approx(1.0, rel=0.02)
    # 5 m/s2 is 0.25 m/s a control step.
    assert max(after - before for before, after in pairwise(speeds)) < allowed(backend, 0.27, 0.32)


@every_backend
def test_yaw_rate_keeps_its_limit(backend):
    drive = Drive(backend)
    yaws, rates = [], []
    for _ in range(80):
        drive.step(0.0, np.pi)
        yaws.append(drive.stage.yaw)
        rates.append(drive.stage.angular[2])
    yaws = np.unwrap(yaws)
    second = round(1.0 / STEP_S)
    assert (yaws[second:] - yaws[:-second]).max() < 2.0 * 1.1
    # Tyres that slip and grip again make the loop swing about the limit: it winds up while the motors, which
    # weaken as they speed up, cannot follow.
    assert max(rates) < 2.0 * allowed(backend, 1.4, 1.5)
    assert yaws[-1] - yaws[second] == pytest.approx(2.0 * (80 - second - 1) * STEP_S, rel=0.1)


def rover_with_torque(torque_nm: float) -> RoverZeroConf:
    return RoverZeroConf(drive=RoverZeroDriveConf(max_torque_nm=torque_nm))


@every_backend
@pytest.mark.parametrize(("share", "climbs"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("torque", [0.6, 1.0])
def test_the_steepest_climb_is_that_of_the_torque(backend, torque, share, climbs):
    steepest = np.arcsin(4 * torque / WHEEL_RADIUS_M / (MASS_KG * GRAVITY_MPS2))
    slope = share * steepest
    quaternion = quaternion_of(0.0, slope)
    uphill, _, up = rotation_matrices(quaternion).T
    drive = Drive(
        backend,
        rover_with_torque(torque),
        [plane(slope)],
        quaternion=quaternion,
        position_w=up * (WHEEL_RADIUS_M + 0.001),
    )
    start = drive.stage.position
    for _ in range(60):
        drive.step(0.5, 0.0)
    assert ((drive.stage.position - start) @ uphill > 0.2) == climbs


@every_backend
@pytest.mark.parametrize(("torque", "slips"), [(1.0, False), (6.0, True)])
def test_wheels_against_a_wall_stall_or_slip_as_torque_and_friction_say(backend, torque, slips):
    # Tyres hold 11 kg x 9.81 x 0.125 m / 4 = 3.4 N m a wheel.
    wall = box((0.4 + HULL_HALF_LENGTH_M, 0.0), 0.2, 4.0, 1.0)
    drive = Drive(backend, rover_with_torque(torque), [plane(), wall])
    turned = np.zeros(4)
    for step in range(60):
        drive.step(0.5, 0.0)
        turned += (step >= 30) * drive.stage.wheel_speeds * STEP_S
    assert drive.stage.contacts() == {1}
    assert drive.stage.position[0] == pytest.approx(0.3, abs=0.01)
    assert (turned.sum() > allowed(backend, 0.5, 0.45) * 4 * 30 * STEP_S * 0.5 / WHEEL_RADIUS_M) == slips
    if not slips:
        np.testing.assert_allclose(turned, 0.0, atol=0.3)


def drive_with_strength(backend, strength: float, slope: float = 0.0) -> tuple[Drive, np.ndarray]:
    """A rover, on a slope, whose motors have `strength`, and the direction uphill."""
    uphill, _, up = rotation_matrices(quaternion_of(0.0, slope)).T
    drive = Drive(backend, statics=[plane(slope)])
    drive.stage.engine.set_body(BodyVariation(motor_strength=strength))
    drive.start(0.0, quaternion_of(0.0, slope), up * (WHEEL_RADIUS_M + 0.001))
    return drive, uphill


@pytest.mark.slow(all_but=["*dart*"])
@every_backend
@pytest.mark.parametrize("strength", [0.3, 0.45, 1.0])
def test_weak_motors_climb_as_fast_as_their_curve_says(backend, strength):
    slope = np.radians(20.0)
    drive, uphill = drive_with_strength(backend, strength, slope)
    for _ in range(40):
        drive.step(1.0, 0.0)
    start = drive.stage.position
    for _ in range(40):
        drive.step(1.0, 0.0)
    conf = RoverZeroConf().drive
    assert conf.no_load_speed_radps is not None
    torque = MASS_KG * GRAVITY_MPS2 * np.sin(slope) * WHEEL_RADIUS_M / 4
    range_radps = conf.no_load_speed_radps - conf.full_torque_speed_radps
    wheel_speed = strength * conf.no_load_speed_radps - torque * range_radps / conf.max_torque_nm
    expected = min(1.0, wheel_speed * WHEEL_RADIUS_M)
    # DART's joints bear on each other through the body: its curve is right within a tenth.
    speed = (drive.stage.position - start) @ uphill / (40 * STEP_S)
    assert speed == pytest.approx(expected, rel=allowed(backend, 0.05, 0.2))


@every_backend
def test_weak_motors_are_slower_on_the_flat_and_in_curves(backend):
    speeds = []
    for strength in (0.3, 1.0):
        drive, _ = drive_with_strength(backend, strength)
        for _ in range(60):
            drive.step(1.0, 0.0)
        speeds.append(drive.stage.velocity[0])
    # 6 rad/s without load are 0.75 m/s.
    assert speeds[0] == pytest.approx(0.75, rel=allowed(backend, 0.05, 0.2))
    assert speeds[1] == pytest.approx(1.0, rel=0.03)
    ways = []
    for strength in (0.5, 0.7, 1.0):
        drive, _ = drive_with_strength(backend, strength)
        track = []
        for step in range(60):
            drive.step(0.8, 0.8 if step // 10 % 2 == 0 else -0.8)
            track.append(drive.stage.position[:2])
        ways.append(np.hypot(*np.diff(track, axis=0).T).sum())
    # Tyres that scrub sideways take most of the torque.
    assert ways[0] < 0.8 * ways[2]
    assert ways[1] < 0.97 * ways[2]


@every_backend
def test_a_reset_rover_repeats_itself_and_others_go_on(backend):
    def run(drive: Drive) -> np.ndarray:
        states = []
        for number in range(30):
            drive.step(0.7, np.sin(number))
            states.append(drive.stage.state)
        return np.array(states)

    drive = Drive(backend)
    first = run(drive)
    for _ in range(5):
        drive.step(1.0, 2.0)
    drive.start(0.0)
    np.testing.assert_array_equal(run(drive), first)


# -- the controller and the drive alone ------------------------------------------------------------


def test_the_controller_is_the_published_pid():
    controller = HeadingController(HeadingConf(kp=2.0, ki=0.5, kd=0.1), 7.0, 1)
    errors = [0.2, 0.5, -0.1, -0.1]
    integral = previous = 0.0
    for number, error in enumerate(errors):
        integral += error * 0.05
        change = 0.0 if number == 0 else (error - previous) / 0.05
        previous = error
        expected = 2.0 * error + 0.5 * integral + 0.1 * change
        assert controller.yaw_rate(np.array([error]), 0.05) == pytest.approx(expected)


def test_the_controller_takes_the_short_way_through_pi():
    controller = HeadingController(HeadingConf(kp=0.0, ki=0.0, kd=1.0), 100.0, 1)
    controller.yaw_rate(np.array([np.pi - 0.1]), 0.1)
    assert controller.yaw_rate(np.array([-np.pi + 0.1]), 0.1) == pytest.approx(0.2 / 0.1)


def test_the_controller_forgets_only_where_told():
    conf = HeadingConf(kp=1.0, ki=1.0, kd=1.0)
    controller, fresh = HeadingController(conf, 100.0, 2), HeadingController(conf, 100.0, 2)
    controller.yaw_rate(np.array([1.0, 1.0]), 0.05)
    fresh.yaw_rate(np.array([0.0, 1.0]), 0.05)
    controller.reset(np.array([True, False]))
    again = controller.yaw_rate(np.array([0.5, 0.5]), 0.05)
    assert again[0] == pytest.approx(0.5 + 0.5 * 0.05)
    assert again[1] == pytest.approx(0.5 + 1.5 * 0.05 - 0.5 / 0.05)
    assert again[1] == fresh.yaw_rate(np.array([0.5, 0.5]), 0.05)[1]


def test_the_controller_keeps_the_platform_s_limit():
    controller = HeadingController(HeadingConf(), 0.7, 2)
    np.testing.assert_array_equal(controller.yaw_rate(np.array([3.0, -3.0]), 0.05), [0.7, -0.7])


def twist(left: np.ndarray, right: np.ndarray, conf: SkidSteerConf) -> tuple[np.ndarray, np.ndarray]:
    """Speed and yaw rate that wheel speeds mean by the drive's own kinematics."""
    return (
        (left + right) / 2 * conf.wheel_radius_m,
        (right - left) * conf.wheel_radius_m / conf.effective_track_m,
    )


@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=30),
    st.sampled_from([0.02, 0.05, 0.1]),
)
def test_a_commanded_twist_keeps_all_limits(commands, step_s):
    # A rover that turns as told leaves the loop nothing to correct.
    conf = SkidSteerConf()
    drive = SkidSteerDrive(conf, 1)
    speed_before = rate_before = 0.0
    for speed, rate in commands:
        turn = np.clip(rate, -conf.max_yaw_rate_radps, conf.max_yaw_rate_radps)
        grows = conf.max_yaw_acceleration_radps2 * step_s
        obeyed = np.clip(turn, rate_before - grows, rate_before + grows)
        got_speed, got_rate = twist(
            *drive.wheel_speeds(np.array([speed]), np.array([rate]), np.array([obeyed]), step_s), conf
        )
        assert abs(got_speed[0]) <= conf.max_speed_mps + 1e-9
        assert abs(got_speed[0] - speed_before) <= conf.max_acceleration_mps2 * step_s + 1e-9
        assert got_rate[0] == pytest.approx(obeyed, abs=1e-9)
        speed_before, rate_before = got_speed[0], got_rate[0]


def test_a_rover_held_fast_winds_nothing_up():
    conf = SkidSteerConf()
    drive = SkidSteerDrive(conf, 1)
    for _ in range(400):
        held = drive.wheel_speeds(np.zeros(1), np.full(1, 2.0), np.zeros(1), 0.05)
    for _ in range(40):
        freed = drive.wheel_speeds(np.zeros(1), np.zeros(1), np.full(1, 0.5), 0.05)
    # However long it was held, two seconds of turning too fast are enough to turn the wheels round.
    assert twist(*held, conf)[1] < 2.0 + 0.8 + 2.0 + 1e-9
    assert twist(*freed, conf)[1] < 0.0


def test_the_drive_forgets_only_where_told():
    conf = SkidSteerConf()
    drive = SkidSteerDrive(conf, 2)
    both = np.full(2, 1.0)
    for _ in range(20):
        drive.wheel_speeds(both, both, np.zeros(2), 0.05)
    drive.reset(np.array([True, False]))
    speed, _ = twist(*drive.wheel_speeds(both, 0 * both, np.zeros(2), 0.05), conf)
    np.testing.assert_allclose(speed, [0.25, 1.0])
    drive.reset(ALL.repeat(2))
    fresh = SkidSteerDrive(conf, 2)
    np.testing.assert_array_equal(
        drive.wheel_speeds(both, both, np.zeros(2), 0.05), fresh.wheel_speeds(both, both, np.zeros(2), 0.05)
    )


def test_wheels_of_one_side_turn_alike_and_positive_headings_are_left():
    left_front, right_front, left_rear, right_rear = RoverZero(RoverZeroConf(), 1).wheel_commands(
        np.array([[0.0, 0.5]]), np.zeros(1), 0.05
    )[0]
    assert left_front == left_rear < 0 < right_front == right_rear


def test_headings_beyond_half_a_turn_count_as_half_a_turn():
    slow = RoverZeroConf(heading=HeadingConf(kp=0.1))
    beyond, half = (
        RoverZero(slow, 1).wheel_commands(np.array([[0.0, heading]]), np.zeros(1), 0.05)
        for heading in (50.0, np.pi)
    )
    np.testing.assert_array_equal(beyond, half)
