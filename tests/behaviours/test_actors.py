"""Paths, scripted walkers and walkers that are agents."""

import numpy as np
import pytest
from pydantic import ValidationError

from dune_rl.actors.actor import MAX_TURN_RADPS, ActorConf, Actors
from dune_rl.actors.paths import random_paths, spline_path, there_and_back
from dune_rl.errors import WorldError
from dune_rl.geometry.frames import wrap_angle
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

STEP_S = 0.05
BOXES = [(0.0, 0.0, 0.5, 2.0, 1.0), (-5.0, 4.0, 0.0, 1.0, 1.0), (4.0, -5.0, 1.0, 3.0, 0.4)]
BEND = np.array([[-6.0, -4.0], [-2.0, -3.0], [1.0, -6.0], [6.0, -6.0]])


def hills(half: int = 10) -> HeightField:
    heights = np.random.default_rng(0).normal(0.0, 0.2, (2 * half + 1, 2 * half + 1))
    return HeightField(heights, 1.0, (-half, -half))


def yard(*boxes: tuple[float, float, float, float, float], half: int = 10) -> World:
    terrain = HeightField(np.zeros((2 * half + 1, 2 * half + 1)), 1.0, (-half, -half))
    props = [
        Prop(f"box_{i}", "box", *upright_box((x, y), yaw, -0.1, 1.0, length, width))
        for i, (x, y, yaw, length, width) in enumerate(boxes)
    ]
    return World("yard", terrain, props, region=(-half, half, -half, half))


def distance_to_boxes(xy: np.ndarray) -> np.ndarray:
    """By formula, not by the world's grid."""
    nearest = np.full(len(xy), np.inf)
    for x, y, yaw, length, width in BOXES:
        cos, sin = np.cos(yaw), np.sin(yaw)
        offset = (xy - [x, y]) @ np.array([[cos, -sin], [sin, cos]])
        outside = np.maximum(np.abs(offset) - [length / 2, width / 2], 0.0)
        nearest = np.minimum(nearest, np.hypot(*outside.T))
    return nearest


def anywhere(rng: np.random.Generator, n: int, radius_m: float) -> np.ndarray:
    return rng.uniform(-9.0, 9.0, (n, 2))


def actors_of(
    *confs: ActorConf, world: World | None = None, scenes: int = 1, seed: int = 0, start: bool = True
) -> Actors:
    actors = Actors(confs, world or yard(), anywhere, np.random.default_rng(seed), scenes)
    for scene in range(scenes if start else 0):
        actors.reset(scene, np.random.default_rng([seed, scene]), np.array([50.0, 50.0]))
    return actors


def nothing(actors: Actors) -> np.ndarray:
    return np.zeros((len(actors.poses), len(actors.external), 2))


# -- paths -----------------------------------------------------------------------------------------


def test_a_path_has_a_pose_every_five_centimetres():
    path = spline_path(BEND, hills())
    spacing = np.hypot(*np.diff(path[:, :2], axis=0).T)
    np.testing.assert_allclose(spacing, 0.05, atol=1e-4)
    assert 0.05 * len(path) > np.hypot(*np.diff(BEND, axis=0).T).sum()


def test_a_path_goes_through_its_way_points():
    path = spline_path(BEND, hills())
    np.testing.assert_allclose(path[0, :2], BEND[0])
    for point in BEND:
        assert np.hypot(*(path[:, :2] - point).T).min() <= 0.05


def test_a_path_is_smooth():
    yaw = np.unwrap(spline_path(BEND, hills())[:, 3])
    assert np.abs(np.diff(yaw)).max() < 0.1
    assert np.ptp(yaw) > 1.0


def test_a_path_keeps_to_the_ground():
    terrain = hills()
    path = spline_path(BEND, terrain)
    np.testing.assert_allclose(path[:, 2], terrain.height(path[:, :2]), atol=1e-12)
    assert np.ptp(path[:, 2]) > 0.2


def test_a_path_faces_its_next_pose_and_repeats_the_last_heading():
    path = spline_path(BEND, hills())
    dx, dy = np.diff(path[:, :2], axis=0).T
    np.testing.assert_allclose(path[:-1, 3], np.arctan2(dy, dx), atol=1e-12)
    assert path[-1, 3] == path[-2, 3]


def test_two_way_points_are_joined_by_a_line():
    path = spline_path(np.array([[0.0, 0.0], [3.0, 4.0]]), hills())
    np.testing.assert_allclose(path[:, 1] * 3, path[:, 0] * 4, atol=1e-9)
    np.testing.assert_allclose(path[:, 3], np.arctan2(4, 3), atol=1e-6)
    assert 99 <= len(path) <= 101


def test_there_and_back_returns_on_its_own_steps_facing_where_it_goes():
    path = spline_path(BEND, hills())
    loop = there_and_back(path)
    assert len(loop) == 2 * len(path) - 2
    np.testing.assert_array_equal(loop[: len(path) - 1], path[:-1])
    np.testing.assert_array_equal(loop[len(path) - 1 :, :3], path[:0:-1, :3])
    after = np.roll(loop, -1, axis=0)
    dx, dy = (after - loop)[:, :2].T
    np.testing.assert_allclose(wrap_angle(loop[:, 3] - np.arctan2(dy, dx)), 0.0, atol=1e-9)


def test_random_paths_keep_clear_of_obstacles():
    world = yard(*BOXES)
    paths = random_paths(world, anywhere, np.random.default_rng(3), 30, 0.5, (6.0, 12.0))
    assert len(paths) == 30
    for path in paths:
        # The world's own clearance is a grid's, good to some centimetres.
        assert distance_to_boxes(path[:, :2]).min() > 0.5 - 0.08
        assert 6.0 < 0.05 * len(path) < 12.0 * 1.3
    without = random_paths(yard(), anywhere, np.random.default_rng(3), 30, 0.5, (6.0, 12.0))
    assert min(distance_to_boxes(path[:, :2]).min() for path in without) == 0.0


def test_random_paths_depend_on_the_generator_alone():
    world = yard(*BOXES)
    first, again, other = (
        random_paths(world, anywhere, np.random.default_rng(seed), 5, 0.5, (6.0, 12.0)) for seed in (3, 3, 4)
    )
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_no_room_for_a_path_is_an_error_that_says_what_to_change():
    with pytest.raises(WorldError, match=r"no path of 100 to 200 m .* shorten actors\.length_range_m"):
        random_paths(yard(), anywhere, np.random.default_rng(0), 5, 0.5, (100.0, 200.0))


# -- scripted --------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.7])
def test_a_scripted_walker_keeps_its_speed(speed):
    actors = actors_of(ActorConf(waypoints=BEND.tolist(), speed_mps=speed), scenes=4)
    speeds = []
    for _ in range(200):
        before = actors.poses[..., :2].copy()
        actors.move(nothing(actors), STEP_S)
        np.testing.assert_allclose(actors.velocity_w, (actors.poses[..., :2] - before) / STEP_S, atol=1e-9)
        speeds.append(np.hypot(*np.moveaxis(actors.velocity_w, -1, 0)))
    # It turns on the spot at the ends of its path, within a step or two; all else is at its speed.
    assert np.mean(np.abs(np.array(speeds) - speed) < 0.01 * speed) > 0.97
    assert np.max(speeds) < 1.01 * speed


def test_a_scripted_walker_walks_to_the_end_and_back():
    length = 0.05 * (len(spline_path(BEND, hills())) - 1)
    actors = actors_of(ActorConf(waypoints=BEND.tolist()))
    track = []
    for _ in range(round(2 * length / STEP_S) + 1):
        track.append(actors.poses[0, 0].copy())
        actors.move(nothing(actors), STEP_S)
    track = np.array(track)
    for end in (BEND[0], BEND[-1]):
        assert np.hypot(*(track[:, :2] - end).T).min() < 0.06
    np.testing.assert_allclose(track[-1, :2], track[0, :2], atol=0.06)


def test_walkers_differ_between_scenes_and_repeat_with_their_draws():
    confs = (ActorConf(), ActorConf(speed_mps=0.5))
    one, two = actors_of(*confs, scenes=3), actors_of(*confs, scenes=3)
    for _ in range(30):
        one.move(nothing(one), STEP_S)
        two.move(nothing(two), STEP_S)
    np.testing.assert_array_equal(one.poses, two.poses)
    assert len(np.unique(one.poses[..., 0])) == 6
    # A reset of one scene repeats that one, and leaves the others.
    kept = one.poses[1:].copy()
    one.reset(0, np.random.default_rng([0, 0]), np.array([50.0, 50.0]))
    for _ in range(30):
        one.move(nothing(one), STEP_S)
    np.testing.assert_array_equal(one.poses[0], two.poses[0])
    assert not np.array_equal(one.poses[1:], kept)


def test_walkers_start_away_from_the_rover():
    actors = actors_of(ActorConf(start_distance_m=4.0), start=False)
    for seed in range(50):
        actors.reset(0, np.random.default_rng(seed), np.zeros(2))
        assert np.hypot(*actors.poses[0, 0, :2]) >= 4.0


def test_a_walker_whose_path_is_all_near_the_rover_starts_at_its_far_part():
    actors = actors_of(ActorConf(waypoints=((0.0, 0.0), (3.0, 0.0)), start_distance_m=9.0), start=False)
    for seed in range(20):
        actors.reset(0, np.random.default_rng(seed), np.zeros(2))
        assert 2.5 < actors.poses[0, 0, 0] <= 3.0


def test_way_points_through_an_obstacle_are_an_error():
    with pytest.raises(WorldError, match=r"lead through an obstacle of yard: move actors\.waypoints"):
        actors_of(ActorConf(waypoints=((-6.0, 0.0), (6.0, 0.0))), world=yard(*BOXES))


def test_a_scene_may_be_without_actors():
    actors = actors_of(scenes=2)
    actors.move(np.zeros((2, 0, 2)), STEP_S)
    assert actors.poses.shape == (2, 0, 4)
    assert actors.bodies() == ()
    assert actors.names == ()


# -- external --------------------------------------------------------------------------------------

AGENT = ActorConf(controller="external", speed_mps=1.5, waypoints=((-3.0, 6.0), (3.0, 6.0)))


def agent_at(x: float, y: float, yaw: float = 0.0, world: World | None = None) -> Actors:
    actors = actors_of(AGENT, world=world)
    actors.poses[0, 0] = x, y, 0.0, yaw
    return actors


def walk(actors: Actors, speed: float, heading: float, steps: int = 1) -> None:
    for _ in range(steps):
        actors.move(np.array([[[speed, heading]]]), STEP_S)


def test_only_external_actors_have_names_numbered_in_their_order():
    actors = actors_of(ActorConf(), AGENT, ActorConf(), AGENT)
    assert actors.names == ("walker_0", "walker_1")
    np.testing.assert_array_equal(actors.external, [1, 3])
    np.testing.assert_array_equal(actors.scripted, [0, 2])
    assert [body.name for body in actors.bodies()] == ["actor_0", "actor_1", "actor_2", "actor_3"]


def test_an_agent_goes_where_it_turns():
    actors = agent_at(1.0, 1.0, 0.5)
    walk(actors, 1.2, 0.1)
    expected = np.array([np.cos(0.6), np.sin(0.6)])
    np.testing.assert_allclose(actors.poses[0, 0], [*(1.0 + 0.06 * expected), 0.0, 0.6], atol=1e-12)
    np.testing.assert_allclose(actors.velocity_w[0, 0], 1.2 * expected, atol=1e-9)


@pytest.mark.parametrize("heading", [2.0, -2.0])
def test_an_agent_turns_no_faster_than_it_can(heading):
    actors = agent_at(0.0, 0.0, 3.0)
    walk(actors, 0.0, heading, 4)
    expected = 3.0 + np.sign(heading) * MAX_TURN_RADPS * STEP_S * 4
    assert actors.poses[0, 0, 3] == pytest.approx(wrap_angle(np.asarray(expected)))


@pytest.mark.parametrize(("asked", "got"), [(9.0, 1.5), (0.7, 0.7), (-1.0, 0.0)])
def test_an_agent_keeps_its_speed_limits(asked, got):
    actors = agent_at(0.0, 0.0)
    walk(actors, asked, 0.0, 10)
    np.testing.assert_allclose(actors.poses[0, 0, :2], [10 * got * STEP_S, 0.0], atol=1e-9)


def test_an_agent_follows_the_ground():
    slope = HeightField(np.tile(np.arange(21) * 0.2, (21, 1)), 1.0, (-10.0, -10.0))
    actors = agent_at(0.0, 0.0, 0.3, World("slope", slope, region=(-5, 5, -5, 5)))
    walk(actors, 1.0, 0.0, 30)
    x, y, z, _ = actors.poses[0, 0]
    assert x > 1.0
    assert z == pytest.approx(float(slope.height([x, y])))


def test_an_obstacle_stops_an_agent_which_may_turn_away():
    actors = agent_at(-4.0, 0.0, world=yard((0.0, 0.0, 0.0, 2.0, 2.0)))
    walk(actors, 1.5, 0.0, 60)
    # 0.25 m from the box's face at x = -1, as near as whole steps and the world's grid let it come.
    assert actors.poses[0, 0, 0] == pytest.approx(-1.25, abs=0.16)
    assert actors.poses[0, 0, 0] < -1.25 + 0.08
    assert actors.blocked.all()
    assert np.abs(actors.velocity_w).max() == 0.0
    walk(actors, 1.5, np.pi, 30)
    assert not actors.blocked.any()
    assert actors.poses[0, 0, 0] < -1.5


def test_the_edge_of_the_world_stops_an_agent():
    for yaw in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        actors = agent_at(0.0, 0.0, yaw)
        walk(actors, 1.5, 0.0, 200)
        assert np.abs(actors.poses[0, 0, :2]).max() == pytest.approx(9.0, abs=0.08)
        assert np.abs(actors.poses[0, 0, :2]).max() <= 9.0
        assert actors.blocked.all()


def test_an_agent_that_arrives_is_sent_to_the_other_end():
    actors = agent_at(2.0, 6.0)
    np.testing.assert_allclose(actors.goals_w[0, 0], [3.0, 6.0], atol=0.06)
    walk(actors, 1.0, 0.0, 9)
    np.testing.assert_allclose(actors.goals_w[0, 0], [3.0, 6.0], atol=0.06)
    walk(actors, 1.0, 0.0, 3)
    np.testing.assert_allclose(actors.goals_w[0, 0], [-3.0, 6.0], atol=0.06)
    actors.poses[0, 0, :2] = -2.9, 6.0
    walk(actors, 0.0, 0.0)
    np.testing.assert_allclose(actors.goals_w[0, 0], [3.0, 6.0], atol=0.06)


def test_agents_and_scripted_walkers_do_not_mix():
    actors = actors_of(ActorConf(), AGENT)
    alone = actors_of(ActorConf(), AGENT)
    for _ in range(20):
        actors.move(np.array([[[1.5, 0.1]]]), STEP_S)
        alone.move(np.zeros((1, 1, 2)), STEP_S)
    np.testing.assert_array_equal(actors.poses[:, 0], alone.poses[:, 0])
    assert not np.array_equal(actors.poses[:, 1], alone.poses[:, 1])


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"waypoints": ((0.0, 0.0),)}, "at least two points"),
        ({"waypoints": ((0.0, 0.0), (5.0, 0.0), (5.0, 0.0))}, "waypoints"),
        ({"length_range_m": (5.0, 4.0)}, "length_range_m must rise"),
        ({"length_range_m": (0.5, 4.0)}, r"from at least 1\.0"),
        ({"height_m": 0.5, "radius_m": 0.25}, "more than twice radius_m"),
        ({"speed_mps": 0.0}, "speed_mps"),
        ({"speed_mps": 6.0}, "speed_mps"),
        ({"controller": "remote"}, "controller"),
        ({"speed": 1.0}, "speed"),
    ],
)
def test_faulty_settings_are_refused(fault, message):
    with pytest.raises(ValidationError, match=message):
        ActorConf(**fault)
