"""Vehicles, animals and drones: how they move, stop, lean with the ground, and where they do not go."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from yards import Box, yard

from dune_rl.behaviours.go_to_goal import GoToGoal
from dune_rl.bodies.motion import MOTION_MODELS, MotionLimits, MotionModelName
from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings
from dune_rl.env.kinematic import KinematicBody
from dune_rl.geometry.frames import rotation_from_angles, wrap_angle
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import Prop, World

STEP_S = 0.05
WALL: Box = (6.0, 0.0, 0.0, 1.0, 12.0)
VEHICLES = ("car", "truck", "tractor")


def conf_of(name: str, **settings: object) -> BodySettings:
    made: BodySettings = BODIES.parse_settings({"name": name, **settings})
    return made


def bodies(
    name: str, *poses: tuple[float, float, float], world: World | None = None, **settings: str
) -> KinematicBody:
    """Bodies of one scene at (x, y, yaw)."""
    worlds = BatchedWorlds([(world or yard(half=30), WeatherConf())])
    made = KinematicBody(conf_of(name, **settings), worlds, len(poses), STEP_S)
    ground = (world or yard(half=30)).terrain.height(np.array(poses)[:, :2])
    made.place(0, np.array([(x, y, z, yaw) for (x, y, yaw), z in zip(poses, ground, strict=True)]))
    made.read_start(np.ones(len(poses), bool))
    return made


def drive(body: KinematicBody, *action: float, steps: int = 1) -> np.ndarray:
    """The poses (steps + 1, N, 6) on the way."""
    poses = [body.poses]
    for _ in range(steps):
        body.command(np.tile(action, (len(body.poses), 1)), body.motion)
        body.read()
        poses.append(body.poses)
    return np.array(poses)


def slope(rise: float, half: int = 30) -> World:
    heights = np.tile(rise * np.arange(-half, half + 1), (2 * half + 1, 1))
    return World("slope", HeightField(heights, 1.0, (-half, -half)), region=(-half, half, -half, half))


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_drives_on_its_turning_circle(name: str) -> None:
    body = bodies(name, (0.0, 0.0, 0.3))
    conf, limits = body.conf, body.limits
    poses = drive(body, 2.0, np.pi / 2, steps=600)[100:, 0]
    front = conf.supports_b[1]
    rotation = rotation_from_angles(poses[:, [4, 5, 3]])
    outer = np.einsum("nij,j->ni", rotation[:, :2, :2], front) + poses[:, :2]
    across = np.linalg.norm(outer[:, None] - outer, axis=-1).max()
    assert across == pytest.approx(conf.turning_circle_m, rel=0.01)
    # The rear axle has no speed aside.
    rear = poses[:, :2] - limits.rear_m * rotation[:, :2, 0]
    change, middle = np.diff(rear, axis=0), rotation[:-1] + rotation[1:]
    aside = np.einsum("ni,ni->n", change, middle[:, :2, 1]) / np.linalg.norm(middle[:, :2, 1], axis=1)
    np.testing.assert_allclose(aside, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_never_turns_on_the_spot(name: str) -> None:
    body = bodies(name, (0.0, 0.0, 0.3))
    poses = drive(body, 0.0, 2.0, steps=20)
    np.testing.assert_allclose(poses - poses[0], 0.0, atol=1e-12)


def test_a_truck_takes_time_to_start_and_to_stop() -> None:
    body = bodies("truck", (-20.0, 0.0, 0.0))
    speeds = []
    for wanted in [4.0] * 100 + [0.0] * 60:
        drive(body, wanted, 0.0)
        speeds.append(body.motion.velocity_w[0, 0])
    change = np.diff([0.0, *speeds]) / STEP_S
    assert change.max() == pytest.approx(body.limits.acceleration_mps2)
    assert change.min() == pytest.approx(-body.limits.braking_mps2)
    assert max(speeds) == pytest.approx(4.0)
    assert speeds[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", [*VEHICLES, "cow", "dog", "sheep"])
def test_bodies_brake_before_a_wall(name: str) -> None:
    body = bodies(name, (-12.0, 0.0, 0.0), world=yard(WALL, half=30))
    wanted = body.limits.max_speed_mps
    poses, brakings = [], []
    speed = 0.0
    for _ in range(400):
        if body.blocked.any():
            break
        drive(body, wanted, 0.0)
        poses.append(body.poses[0, 0])
        brakings.append((speed - body.motion.velocity_w[0, 0]) / STEP_S)
        speed = body.motion.velocity_w[0, 0]
    front = poses[-1] + body.conf.size_m[0] / 2
    assert 4.6 < front <= 5.5 + 0.05
    # Not more than its brakes can.
    assert max(brakings) <= body.limits.braking_mps2 + 1e-6


def test_a_vehicle_drives_back_to_get_free() -> None:
    body = bodies("car", (2.0, 0.0, 0.0), world=yard(WALL, half=30))
    poses = drive(body, 3.0, 1.5, steps=400)[:, 0]
    ahead = np.einsum("ni,ni->n", np.diff(poses[:, :2], axis=0), _heading(poses[:-1]))
    assert ahead.min() < -0.01
    # The middle of the car is a little faster than its rear axle.
    assert -ahead.min() <= 1.01 * body.limits.max_reverse_mps * STEP_S
    # In the end it is away from the wall.
    assert np.abs(poses[-1, :2] - poses[0, :2]).max() > 5.0


def _heading(poses: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(poses[:, 3]), np.sin(poses[:, 3])], axis=-1)


def test_bodies_keep_their_whole_length_off_obstacles_and_the_edge() -> None:
    world = yard(WALL, (-5.0, 6.0, 0.4, 2.0, 2.0), half=15)
    rng = np.random.default_rng(4)
    for name in ("truck", "cow"):
        body = bodies(name, (-8.0, -6.0, 0.5), (0.0, -8.0, 2.0), world=world)
        for _ in range(300):
            action = np.column_stack([rng.uniform(0.5, 4.0, 2), rng.uniform(-1.5, 1.5, 2)])
            body.command(action, body.motion)
            body.read()
            outline = body.outline_points(0)
            assert np.abs(outline).max() < 15.0
            assert world.clearance(outline).min() > 0.0


def test_a_holonomic_body_goes_aside() -> None:
    limits = MotionLimits("holonomic", 1.0, max_turn_radps=1.0)
    poses = np.array([[0.0, 0.0, 0.0, 0.4, 0.0, 0.0]])
    advance = MOTION_MODELS.bind(MOTION_MODELS.parse_motion(limits.model))
    step = advance(limits, poses, np.zeros((1, 2)), np.array([[1.0, np.pi / 2]]), STEP_S)
    way = 0.4 + np.pi / 2
    np.testing.assert_allclose(step.xy, [[STEP_S * np.cos(way), STEP_S * np.sin(way)]], atol=1e-12)
    np.testing.assert_allclose(step.yaw, [0.45])


@pytest.mark.parametrize("model", ["unicycle", "holonomic"])
def test_a_body_without_a_limit_turns_at_once(model: MotionModelName) -> None:
    limits = MotionLimits(model, 1.0)
    poses = np.zeros((1, 6))
    advance = MOTION_MODELS.bind(MOTION_MODELS.parse_motion(limits.model))
    step = advance(limits, poses, np.zeros((1, 2)), np.array([[0.5, 2.0]]), STEP_S)
    np.testing.assert_allclose(step.yaw, [2.0])


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("name", [*VEHICLES, "cow", "sheep", "dog"])
def test_bodies_lean_with_the_ground(name: str, yaw: float) -> None:
    world = slope(0.2)
    body = bodies(name, (1.3, 2.1, yaw), world=world)
    drive(body, 1.0, 0.0, steps=10)
    normal = rotation_from_angles(body.poses[:, [4, 5, 3]])[0, :, 2]
    np.testing.assert_allclose(normal, np.array([-0.2, 0.0, 1.0]) / np.hypot(0.2, 1.0), atol=1e-9)
    np.testing.assert_allclose(body.motion.rotation[0, :, 2], normal, atol=1e-12)
    assert body.poses[0, 2] == pytest.approx(0.2 * body.poses[0, 0])


def test_persons_stay_upright() -> None:
    body = bodies("person", (1.3, 2.1, 0.4), world=slope(0.2))
    drive(body, 1.0, 0.0, steps=10)
    np.testing.assert_allclose(body.poses[:, 4:], 0.0, atol=1e-15)


def test_turning_rates_are_those_of_the_attitude() -> None:
    waves = np.sin(np.arange(61) / 3.0) * 0.3
    world = World("waves", HeightField(np.tile(waves, (61, 1)), 1.0, (-30.0, -30.0)), region=(-9, 9, -9, 9))
    body = bodies("dog", (-5.0, 0.0, 0.5), world=world)
    before = rotation_from_angles(body.poses[:, [4, 5, 3]])
    for _ in range(40):
        drive(body, 2.0, 0.3)
        after = rotation_from_angles(body.poses[:, [4, 5, 3]])
        axis = body.motion.angular_w[0] * STEP_S
        angle = np.linalg.norm(axis)
        cross = np.cross(np.eye(3), axis / max(angle, 1e-12)).T
        turn = np.eye(3) + np.sin(angle) * cross.T + (1 - np.cos(angle)) * cross @ cross
        np.testing.assert_allclose(turn @ before[0], after[0], atol=1e-6)
        before = after


@pytest.mark.parametrize(("name", "limit"), [("cow", 30.0), ("car", 18.0), ("person", 45.0)])
def test_bodies_keep_off_slopes_that_they_cannot_pass(name: str, limit: float) -> None:
    heights = np.concatenate([np.zeros(40), np.tan(np.deg2rad(limit + 5.0)) * np.arange(1.0, 22.0)])
    world = World("bank", HeightField(np.tile(heights, (61, 1)), 1.0, (-30.0, -30.0)), region=(-9, 9, -9, 9))
    body = bodies(name, (0.0, 0.0, 0.0), world=world)
    ahead = drive(body, 1.0, 0.0, steps=400)[:, 0, 0]
    assert 3.0 < ahead.max() < 11.0
    assert ahead[300:].max() < 11.0
    gentle = World(
        "ramp", HeightField(np.tile(0.7 * heights, (61, 1)), 1.0, (-30.0, -30.0)), region=(-9, 9, -9, 9)
    )
    body = bodies(name, (0.0, 0.0, 0.0), world=gentle)
    drive(body, 1.0, 0.0, steps=320)
    assert body.poses[0, 0] > 12.0


@pytest.mark.parametrize(("name", "wades"), [("child", False), ("person", True), ("sheep", False)])
def test_bodies_keep_off_water_that_is_too_deep(name: str, wades: bool) -> None:
    heights = np.concatenate([np.zeros(35), np.full(26, -0.8)])
    lake = np.array([[3.0, -30.0, -0.1], [30.0, -30.0, -0.1], [30.0, 30.0, -0.1], [3.0, 30.0, -0.1]])
    water = Prop("lake", "water", lake, np.array([[0, 1, 2], [0, 2, 3]], np.int32), solid=False)
    terrain = HeightField(np.tile(heights, (61, 1)), 1.0, (-30.0, -30.0))
    body = bodies(name, (0.0, 0.0, 0.0), world=World("lake", terrain, [water], region=(-9, 9, -9, 9)))
    drive(body, 1.0, 0.0, steps=200)
    assert (body.poses[0, 0] > 7.0) == wades
    assert body.blocked[0] != wades


def test_a_drone_keeps_its_height_and_rises_over_what_is_lower() -> None:
    low: Box = (6.0, 0.0, 0.0, 2.0, 8.0)
    world = yard(low, half=30)
    assert max(prop.vertices[:, 2].max() for prop in world.props) == pytest.approx(1.0)
    body = bodies("drone", (-5.0, 0.0, 0.0), world=world)
    assert body.poses[0, 2] == pytest.approx(3.0)
    body.place(0, np.array([[-5.0, 0.0, 0.0, 0.0]]))
    drive(body, 0.0, 0.0, -1.5, steps=40)
    assert body.poses[0, 2] == pytest.approx(0.5)
    poses = drive(body, 3.0, 0.0, 0.0, steps=200)[:, 0]
    over = np.abs(poses[:, 0] - 6.0) < 1.0
    assert over.any()
    assert poses[over, 2].min() >= 1.0 + body.conf.flight.room_m - 1e-6
    assert poses[-1, 0] > 8.0
    assert np.abs(np.diff(poses[:, 2])).max() <= body.limits.max_climb_mps * STEP_S + 1e-9


def test_a_drone_stops_before_what_is_too_high() -> None:
    vertices = np.array(
        [[x, y, z] for z in (0.0, 15.0) for x, y in ((5, -9), (7, -9), (7, 9), (5, 9))], float
    )
    faces = np.array(
        [
            *([0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]),
            *([1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]),
        ],
        np.int32,
    )
    level = HeightField(np.zeros((61, 61)), 1.0, (-30.0, -30.0))
    tower = World("tower", level, [Prop("tower", "box", vertices, faces)], region=(-9, 9, -9, 9))
    body = bodies("drone", (0.0, 0.0, 0.0), world=tower)
    poses = drive(body, 5.0, 0.0, 0.0, steps=200)[:, 0]
    assert 3.0 < poses[-1, 0] < 4.8
    # The border of a roof is as wide as a cell of its grid.
    np.testing.assert_allclose(poses[:, 2], 3.0, atol=0.3)


def test_frames_follow_the_way_walked() -> None:
    body = bodies("cow", (0.0, 0.0, 0.0), (0.0, 5.0, 1.0))
    conf = body.conf
    start = body.motion.frames
    assert start[0] != start[1]
    poses = drive(body, 1.0, 0.0, steps=60)
    way = np.linalg.norm(np.diff(poses[:, 0, :2], axis=0), axis=1).sum()
    assert body.motion.frames[0] == np.floor(12 * way / conf.stride_m) % 12
    standing = drive(body, 0.0, 0.0, steps=20)
    frames = body.motion.frames
    drive(body, 0.0, 0.5, steps=5)
    np.testing.assert_array_equal(body.motion.frames, frames)
    assert len(standing) == 21


def test_people_in_mixed_clothes_keep_their_outfits() -> None:
    places = [(0.0, float(number), 0.0) for number in range(8)]
    body = bodies("child", *places, clothes="mixed")
    outfits = [0, 1, 2, 3, 4, 5, 0, 1]
    np.testing.assert_array_equal(body.motion.frames // 12, outfits)
    drive(body, 1.0, 0.0, steps=30)
    np.testing.assert_array_equal(body.motion.frames // 12, outfits)


def test_actions_are_bounded_by_the_motion_model() -> None:
    low, high = bodies("truck", (0.0, 0.0, 0.0)).action_bounds()
    np.testing.assert_allclose([low, high], [[-1.0, -np.pi], [4.0, np.pi]])
    low, high = bodies("drone", (0.0, 0.0, 0.0)).action_bounds()
    np.testing.assert_allclose([low, high], [[0.0, -np.pi, -1.5], [5.0, np.pi, 1.5]])
    low, high = bodies("cow", (0.0, 0.0, 0.0)).action_bounds()
    np.testing.assert_allclose([low, high], [[0.0, -np.pi], [1.4, np.pi]])


def test_a_body_that_a_robot_held_back_starts_anew_and_leans_where_it_is() -> None:
    world = slope(0.15)
    body = bodies("truck", (0.0, 0.0, 0.0), (0.0, 9.0, 0.0), world=world)
    drive(body, 3.0, 0.0, steps=30)
    body.command(np.tile([3.0, 0.0], (2, 1)), body.motion)
    commanded = body.poses.copy()
    reached = commanded[None, :, :4].copy()
    reached[0, 0, 0] -= 0.05
    body.hold_back(np.array([0]), reached)
    body.read()
    np.testing.assert_array_equal(body.poses[1], commanded[1])
    assert body.poses[0, 2] == pytest.approx(0.15 * body.poses[0, 0])
    drive(body, 3.0, 0.0)
    speeds = body.motion.velocity_b[:, 0]
    assert speeds[0] == pytest.approx(1.0 * STEP_S, rel=0.05)
    assert speeds[1] > 1.0


def test_headings_are_kept_within_a_turn() -> None:
    body = bodies("dog", (0.0, 0.0, 3.0))
    poses = drive(body, 0.5, 1.0, steps=100)[:, 0, 3]
    assert np.abs(poses).max() <= np.pi
    turned = wrap_angle(np.diff(poses))
    np.testing.assert_allclose(turned, 4.0 * STEP_S, atol=1e-9)


@pytest.mark.slow(all_but=["car"])
@pytest.mark.parametrize("name", VEHICLES)
def test_go_to_goal_reaches_goals_all_round_a_vehicle(name: str) -> None:
    rng = np.random.default_rng(0)
    number = 200
    body = bodies(name, *((0.0, 0.0, yaw) for yaw in rng.uniform(-3.0, 3.0, number)))
    goals = rng.uniform(-6.0, 6.0, (number, 2))
    driver = GoToGoal(number, speed_mps=3.0)
    reached = np.zeros(number, bool)
    for _ in range(900):
        offset = goals - body.poses[:, :2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - body.poses[:, 3])
        reached |= distance < 0.75
        state: Any = SimpleNamespace(
            goal=SimpleNamespace(distance=distance, bearing=bearing),
            body=body.description,
        )
        body.command(driver.act(state, state), body.motion)
        body.read()
    assert reached.all()


def test_an_episode_does_not_begin_with_the_way_round_of_the_last_one() -> None:
    """Goals at the side, inside the tightest curve and then on it."""
    driver = GoToGoal(2)
    body = bodies("car", (0.0, 0.0, 0.0)).description

    def heading(radii: float) -> list[float]:
        distance = np.full(2, radii * body.turning_radius_m)
        goal = SimpleNamespace(distance=distance, bearing=np.full(2, np.pi / 2))
        group: Any = SimpleNamespace(goal=goal, body=replace(body, rear_axle_m=0.0))
        found: list[float] = driver.act(group, group)[:, 1].tolist()
        return found

    assert heading(1.0) == [0.0, 0.0]
    assert heading(2.0) == [0.0, 0.0]
    driver.reset(np.array([False, True]), Any)
    assert heading(2.0) == [0.0, np.pi / 2]


def test_vehicles_start_towards_a_way_that_they_can_go() -> None:
    # Only the third has the wall before it.
    world = yard((6.0, 0.0, 0.0, 1.0, 30.0), half=30)
    body = bodies("truck", (-15.0, 0.0, 1.0), (-15.0, 12.0, 0.0), (0.5, 0.0, 0.0), world=world)
    poses = np.array([(-15.0, 0.0, 0.0, 1.0), (-15.0, 12.0, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0)])
    faced = body.turned_to_free_way(0, poses)
    np.testing.assert_array_equal(faced[:2], poses[:2])
    np.testing.assert_array_equal(faced[:, :3], poses[:, :3])
    # Straight ahead and 30 degrees aside is the wall.
    assert faced[2, 3] == pytest.approx(np.pi / 3)
    body.place(0, faced)
    body.read_start(np.ones(3, bool))
    driven = drive(body, 2.0, 0.0, steps=60)
    assert np.linalg.norm(driven[-1, 2, :2] - driven[0, 2, :2]) > 2.0
    # Who turns on the spot needs none of it.
    walker = bodies("person", (0.5, 0.0, 0.0), world=world)
    assert walker.turned_to_free_way(0, poses) is poses


def test_a_vehicle_that_is_shut_in_faces_where_it_was_put() -> None:
    walls: list[Box] = [(5.5, 0.0, 0.0, 1.0, 12.0), (-5.5, 0.0, 0.0, 1.0, 12.0)]
    walls += [(0.0, 5.5, 0.0, 12.0, 1.0), (0.0, -5.5, 0.0, 12.0, 1.0)]
    body = bodies("truck", (0.0, 0.0, 0.3), world=yard(*walls, half=30))
    poses = np.array([(0.0, 0.0, 0.0, 0.3)])
    np.testing.assert_array_equal(body.turned_to_free_way(0, poses), poses)
