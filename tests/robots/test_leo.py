"""Leo Rover: its rockers, its drive, and the figures of its description."""

from xml.etree.ElementTree import Element

import numpy as np
import pytest
from defusedxml.ElementTree import parse
from scenes import (
    BACKENDS,
    GRAVITY_MPS2,
    SUBSTEPS,
    TIMESTEP_S,
    Drive,
    Stage,
    about,
    allowed,
    box,
    every_backend,
    ground,
    plane,
    quaternion_of,
    slope_stage,
)

from dune_rl.core.paths import assets_folder
from dune_rl.geometry.heightfield import HeightField
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf

FOLDER = assets_folder() / "robots" / "leo_rover"
ROCKERS = ("left_rocker_joint", "right_rocker_joint")
MASS_KG = 1.585 + 2 * 1.387 + 4 * 0.284
KP = LeoRoverConf().heading.kp


def leo_on(backend, statics=None, **place) -> Drive:
    rover = LeoRover(LeoRoverConf(), 1)
    place = {"position_w": (0.0, 0.0, rover.description.standing_height_m + 0.002)} | place
    return Drive(backend, rover=rover, statics=statics, **place)


def leo_on_slope(backend, slope: float, yaw: float) -> Stage:
    rover = LeoRover(LeoRoverConf(), 1)
    return slope_stage(
        backend, slope, 1.0, yaw, rover.body, height_m=rover.description.standing_height_m + 0.002
    )


def rockers(stage: Stage) -> np.ndarray:
    return np.array(stage.engine.joint_angles(ROCKERS))


def stones(seed: int) -> HeightField:
    heights = np.random.default_rng(seed).uniform(0.0, 0.08, (81, 81))
    return HeightField(heights, 0.25, (-10.0, -10.0))


@every_backend
def test_it_stands_at_its_height_with_level_rockers(backend):
    drive = leo_on(backend)
    drive.stage.step(200)
    # Its centre of mass is off the origin, which is what is told.
    np.testing.assert_allclose(drive.stage.position, [0.0, 0.0, 0.198], atol=allowed(backend, 1.5e-3, 2e-3))
    np.testing.assert_allclose(rockers(drive.stage), 0.0, atol=1e-3)
    assert np.linalg.norm(drive.stage.velocity) < 1e-3


@every_backend
def test_free_fall_is_that_of_its_origin(backend):
    drive = leo_on(backend, position_w=(0.0, 0.0, 5.0), quaternion=about([0.6, 0.0, 0.8], 1.0))
    upright, before = drive.stage.rotation, drive.stage.position
    drive.stage.step(60)
    np.testing.assert_allclose(drive.stage.rotation, upright, atol=1e-6)
    np.testing.assert_allclose(drive.stage.position[:2], before[:2], atol=1e-6)


@every_backend
@pytest.mark.parametrize("speed", [0.4, 0.2, -0.4])
def test_it_drives_straight_at_the_speed_told(backend, speed):
    drive = leo_on(backend, yaw=0.6)
    for _ in range(20):
        drive.step(speed, 0.0)
    start = drive.stage.position
    for _ in range(60):
        drive.step(speed, 0.0)
    way = drive.stage.position - start
    ahead = np.array([np.cos(0.6), np.sin(0.6)])
    assert way[:2] @ ahead / 3.0 == pytest.approx(speed, rel=0.03)
    assert abs(way[0] * -ahead[1] + way[1] * ahead[0]) < 0.03


@pytest.mark.slow(all_but=["1.0471975511965976-0.4-bullet"])
@every_backend
@pytest.mark.parametrize("yaw", [0.0, 0.4, np.pi / 4])
@pytest.mark.parametrize("rate", [0.3, np.deg2rad(60.0)])
def test_it_turns_on_the_spot_as_fast_as_told(backend, yaw, rate):
    drive = leo_on(backend, yaw=yaw)
    yaws = []
    for _ in range(60):
        drive.step(0.0, rate / KP)
        yaws.append(drive.stage.yaw)
    yaws = np.unwrap(yaws)
    assert (yaws[-1] - yaws[19]) / 2.0 == pytest.approx(rate, rel=0.1)
    # Its rear axle carries more and slips less, so that it turns about a point near that: in half a turn it
    # gets no farther than twice their distance.
    assert np.linalg.norm(drive.stage.position[:2]) < allowed(backend, 0.25, 0.3)


@pytest.mark.slow
@every_backend
@pytest.mark.parametrize("seed", [0, 1])
def test_over_stones_the_rockers_turn_opposite_and_all_wheels_stay_on_the_ground(backend, seed):
    terrain = stones(seed)
    drive = leo_on(backend, [ground(terrain)], position_w=(-5.0, 0.0, 0.3), yaw=0.2)
    middles = LeoRover.description.contact_centres_b - [0.0026, 0.0, -0.0473]
    largest = 0.0
    for step in range(160):
        drive.step(0.4, 0.1 * np.sin(step / 30))
        left, right = rockers(drive.stage)
        assert abs(left + right) < 1e-3
        largest = max(largest, abs(left))
        if step % 10:
            continue
        # No wheel is above the ground by more than the stones' edges let a ball's lowest point be.
        for middle, angle in zip(middles, (left, right, left, right), strict=True):
            cos, sin = np.cos(angle), np.sin(angle)
            turned = [cos * middle[0] + sin * middle[2], middle[1], cos * middle[2] - sin * middle[0]]
            where = drive.stage.position + drive.stage.rotation @ (turned + np.array([0.0026, 0.0, -0.0473]))
            round_it = where[:2] + 0.06 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            assert where[2] - 0.0625 - terrain.height(round_it).max() < allowed(backend, 0.004, 0.007)
    assert largest > 0.05
    assert drive.stage.position[0] > -3.0


@every_backend
def test_the_body_carries_the_mean_of_its_rockers(backend):
    # One side on a block: without a differential the body would pitch as the rocker does, or not at all.
    heights = np.zeros((41, 41))
    x, y = np.meshgrid(np.arange(41) * 0.1 - 2.0, np.arange(41) * 0.1 - 2.0)
    heights[(x > 0.0) & (y > 0.0)] = 0.05
    drive = leo_on(backend, [ground(HeightField(heights, 0.1, (-2.0, -2.0)))], position_w=(0.0, 0.0, 0.25))
    # DART lifts what has sunk in at the landing by a millimetre a second.
    drive.stage.step(900)
    left, right = rockers(drive.stage)
    pitch = np.arcsin(-drive.stage.rotation[2, 0])
    assert abs(left - right) / 2 > 0.06
    # The right wheels are level, the left ones 0.05 m apart in height: the body has half of that slope.
    slope = np.arctan(0.05 / 0.3052)
    assert pitch + right == pytest.approx(0.0, abs=0.01)
    assert pitch + left == pytest.approx(-slope, abs=0.01)
    assert pitch == pytest.approx(-slope / 2, abs=0.01)


@every_backend
def test_a_slope_that_is_too_steep_for_its_motors_stops_it(backend):
    # At 0.4 m/s its motors have fallen to 2 (1 - 6.4 / 9.4) - 0.3125 Nm each.
    spare = 4 * (2.0 * (1 - 6.4 / 9.4) - 0.3125) / 0.0625
    for share, slower in ((0.8, False), (1.6, True)):
        slope = np.arcsin(share * spare / (MASS_KG * 9.81))
        quaternion = quaternion_of(0.0, slope)
        up = np.array([-np.sin(slope), 0.0, np.cos(slope)])
        drive = leo_on(backend, [plane(slope)], quaternion=quaternion, position_w=0.2 * up)
        for _ in range(60):
            drive.step(0.4, 0.0)
        speed = float(np.linalg.norm(drive.stage.velocity))
        assert (speed < 0.385) == slower
        # It gets along all the same: slowly, it is strong.
        assert speed > 0.2


@every_backend
@pytest.mark.parametrize(("yaw", "creep_m"), [(0.0, 0.02), (np.pi / 2, 1e-3)], ids=["uphill", "across"])
def test_it_holds_on_a_slope(backend, yaw, creep_m):
    stage = leo_on_slope(backend, 0.3, yaw)
    stage.step(100)
    before = stage.position
    # What creeps is servos that brake.
    stage.step(SUBSTEPS * 100)
    assert np.linalg.norm(stage.position - before) < creep_m
    np.testing.assert_allclose(rockers(stage), 0.0, atol=1e-3)


def test_wheels_in_the_air_do_not_roll_sideways_at_the_joints_that_let_them_slip():
    # On its belly, on a pillar. Their weight, at joints without friction, once set them rolling ever faster.
    rover = LeoRover(LeoRoverConf(), 1)
    pillar = box((0.0, 0.0), 0.2, 0.16, 0.2, drivable=True)
    stage = Stage(BACKENDS["dart"], [plane(), pillar], robot=rover.body)
    stage.place([0.0, 0.0, 0.3])
    stage.step(600)
    robot = stage.engine.skeleton
    assert stage.position[2] > 0.25
    assert np.abs(robot.getVelocities()).max() < 0.05


@every_backend
@pytest.mark.parametrize("friction", [1.0, 0.6])
def test_across_a_slope_it_slides_iff_that_exceeds_half_its_friction(backend, friction):
    for share, slides in ((0.93, False), (1.2, True)):
        slope = np.arctan(share * 0.5 * friction)
        stage = leo_on_slope(backend, slope, np.pi / 2)
        stage.engine.set_wheel_contacts([friction] * 4, [0.0] * 4)
        stage.step(60)
        before, start = stage.velocity, stage.position
        stage.step(80)
        gained = np.linalg.norm(stage.velocity - before) / (80 * TIMESTEP_S)
        if slides:
            pull = GRAVITY_MPS2 * (np.sin(slope) - 0.5 * friction * np.cos(slope))
            # In DART its wheels, which roll sideways, take a fifteenth of it.
            assert gained == pytest.approx(pull, rel=0.15)
        else:
            assert np.linalg.norm(stage.position - start) < 4e-3


@every_backend
def test_the_same_drive_gives_the_same_bytes_after_a_new_start(backend):
    drive = leo_on(backend, [ground(stones(0))], position_w=(-5.0, 0.0, 0.3))
    found = []
    for _ in range(2):
        drive.start(0.2, position_w=(-5.0, 0.0, 0.3))
        for _ in range(20):
            drive.step(0.4, 0.3)
        found.append((drive.stage.engine.body_state(), drive.stage.engine.drive_state()))
    assert found[0] == found[1]


def _inertials() -> dict[str, Element]:
    root = parse(FOLDER / "leo_rover.urdf").getroot()
    return {link.get("name"): link.find("inertial") for link in root.findall("link")}


@pytest.mark.parametrize(
    ("link", "mass", "inertia"),
    [
        ("base_link", 1.585, (0.01042, 0.01045, 0.01817)),
        ("left_rocker", 1.387, (0.00296, 0.02924, 0.02832)),
        ("right_rocker", 1.387, (0.00296, 0.02924, 0.02832)),
        ("front_left_wheel", 0.284, (0.000391, 0.000472, 0.000391)),
        ("rear_right_wheel", 0.284, (0.000391, 0.000472, 0.000391)),
    ],
)
def test_masses_and_inertias_are_the_makers(link, mass, inertia):
    told = _inertials()[link]
    assert float(told.find("mass").get("value")) == mass
    assert tuple(float(told.find("inertia").get(name)) for name in ("ixx", "iyy", "izz")) == inertia


def test_all_of_it_weighs_what_the_maker_says():
    assert sum(float(each.find("mass").get("value")) for each in _inertials().values()) == pytest.approx(
        5.495
    )
