"""Agents that walk there and back on paths: where they start, how they walk, and where they go."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from yards import BEND, BOXES, hills, points_anywhere, yard

from dune_rl.behaviours.paths.follower import PathConf, PathFollower
from dune_rl.behaviours.paths.splines import spline_path
from dune_rl.bodies.person import PersonConf
from dune_rl.core.errors import WorldError
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.worlds.world import World

STEP_S = 0.05
RADIUS_M = 0.25
FAR_AWAY = np.array([[50.0, 50.0]])


class Walkers:
    """Agents on paths in scenes of one world, and where they are; all have started far from any robot."""

    def __init__(
        self, conf: PathConf, count: int = 1, *, world: World | None = None, scenes: int = 1, seed: int = 0
    ) -> None:
        world = world or yard()
        self.follower = PathFollower(conf, count, RADIUS_M, SharedPerScene([world] * scenes))
        self.follower.find_paths(world, points_anywhere, np.random.default_rng(seed))
        self.poses = np.zeros((scenes * count, 4))
        self.count = count
        for scene in range(scenes):
            self.start(scene, np.random.default_rng([seed, scene]), FAR_AWAY)

    def start(self, scene: int, rng: np.random.Generator, avoid_xy: np.ndarray) -> None:
        rows = slice(scene * self.count, (scene + 1) * self.count)
        self.poses[rows] = self.follower.reset(scene, rng, avoid_xy)

    def walk(self, speed_mps: float = 1.0) -> np.ndarray:
        """Velocities (N, 2) [m/s] of a step."""
        before = self.poses
        self.poses = self.follower.advance(speed_mps * STEP_S)
        return (self.poses[:, :2] - before[:, :2]) / STEP_S


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.7])
def test_a_walker_on_its_path_keeps_its_speed(speed: float) -> None:
    walkers = Walkers(PathConf(waypoints=BEND.tolist()), scenes=4)
    speeds = np.array([np.hypot(*walkers.walk(speed).T) for _ in range(200)])
    # It turns on the spot at the ends of its path, within a step or two; all else is at its speed.
    assert np.mean(np.abs(speeds - speed) < 0.01 * speed) > 0.97
    assert np.max(speeds) < 1.01 * speed


@pytest.mark.parametrize("more", [1, 3])
def test_walkers_more_leave_the_first_ones_as_they_are(more: int) -> None:
    two, others = (Walkers(PathConf(), count, scenes=6) for count in (2, 2 + more))
    for _ in range(3):
        first = others.poses.reshape(6, 2 + more, 4)[:, :2]
        np.testing.assert_array_equal(first, two.poses.reshape(6, 2, 4))
        two.walk()
        others.walk()


def test_a_walker_goes_to_the_end_of_its_path_and_back() -> None:
    length = 0.05 * (len(spline_path(BEND, hills())) - 1)
    walkers = Walkers(PathConf(waypoints=BEND.tolist()))
    track = []
    for _ in range(round(2 * length / STEP_S) + 1):
        track.append(walkers.poses[0].copy())
        walkers.walk()
    for end in (BEND[0], BEND[-1]):
        assert np.hypot(*(np.array(track)[:, :2] - end).T).min() < 0.06
    np.testing.assert_allclose(track[-1][:2], track[0][:2], atol=0.06)


def test_walkers_differ_between_agents_and_scenes_and_repeat_with_their_draws() -> None:
    one, two = (Walkers(PathConf(), count=2, scenes=3) for _ in range(2))
    for _ in range(30):
        one.walk()
        two.walk()
    np.testing.assert_array_equal(one.poses, two.poses)
    assert len(np.unique(one.poses[:, 0])) == 6
    # A reset of one scene repeats that one, and leaves the others.
    kept = one.poses[2:].copy()
    one.start(0, np.random.default_rng([0, 0]), FAR_AWAY)
    for _ in range(30):
        one.walk()
    np.testing.assert_array_equal(one.poses[:2], two.poses[:2])
    assert not np.array_equal(one.poses[2:], kept)


def test_walkers_start_away_from_all_robots() -> None:
    walkers = Walkers(PathConf(start_distance_m=4.0), count=2)
    robots = np.array([[0.0, 0.0], [6.0, 6.0]])
    for seed in range(50):
        walkers.start(0, np.random.default_rng(seed), robots)
        apart = np.linalg.norm(walkers.poses[:, None, :2] - robots, axis=-1)
        assert apart.min() >= 4.0


def test_a_walker_whose_path_is_all_near_the_robot_starts_at_its_far_part() -> None:
    walkers = Walkers(PathConf(waypoints=((0.0, 0.0), (3.0, 0.0)), start_distance_m=9.0))
    for seed in range(20):
        walkers.start(0, np.random.default_rng(seed), np.zeros((1, 2)))
        assert 2.5 < walkers.poses[0, 0] <= 3.0


def test_walkers_may_be_without_robots() -> None:
    walkers = Walkers(PathConf())
    walkers.start(0, np.random.default_rng(1), np.zeros((0, 2)))
    assert np.abs(walkers.poses[0, :2]).max() <= 9.5


def test_way_points_through_an_obstacle_are_an_error() -> None:
    words = (
        r"^actors\.walker\.path\.waypoints: between way-points 1 and 2 the way is in an obstacle at \(-?\d"
    )
    with pytest.raises(WorldError, match=words):
        Walkers(PathConf(waypoints=((-6.0, 0.0), (6.0, 0.0))), world=yard(*BOXES))


def test_goals_are_the_ends_of_the_path_by_turns() -> None:
    walkers = Walkers(PathConf(waypoints=((-3.0, 6.0), (3.0, 6.0))), count=2)
    follower = walkers.follower
    np.testing.assert_allclose(follower.goals_w, [[3.0, 6.0], [3.0, 6.0]], atol=0.06)
    follower.renew(np.array([False, True]))
    np.testing.assert_allclose(follower.goals_w, [[3.0, 6.0], [-3.0, 6.0]], atol=0.06)
    follower.renew(np.array([True, True]))
    np.testing.assert_allclose(follower.goals_w, [[-3.0, 6.0], [3.0, 6.0]], atol=0.06)
    walkers.start(0, np.random.default_rng(0), FAR_AWAY)
    np.testing.assert_allclose(follower.goals_w, [[3.0, 6.0], [3.0, 6.0]], atol=0.06)


def test_paths_are_of_the_world_that_a_scene_is_in() -> None:
    worlds = [yard(), yard(*BOXES)]
    shared = SharedPerScene(worlds)
    follower = PathFollower(PathConf(), 1, RADIUS_M, shared)
    for world in worlds:
        follower.find_paths(world, points_anywhere, np.random.default_rng(0))
    clearances = []
    for scene in range(2):
        follower.reset(scene, np.random.default_rng(1), FAR_AWAY)
        paths = follower.paths(0, scene)
        clearances.append(min(worlds[1].clearance(path).min() for path in paths))
        assert len(paths) >= 8
    assert clearances[0] < RADIUS_M <= clearances[1]
    poses = [follower.advance(0.3) for _ in range(40)]
    for scene, world in enumerate(worlds):
        assert world.clearance(np.array(poses)[:, scene, :2]).min() >= RADIUS_M - 0.05


# -- held back by robots ----------------------------------------------------------------------------


def test_a_walker_that_is_held_back_walks_on_from_there() -> None:
    stopped, free = (Walkers(PathConf(waypoints=BEND.tolist()), scenes=2) for _ in range(2))
    place = stopped.poses[0].copy()
    for _ in range(20):
        stopped.walk()
        stopped.poses[0, :2] = place[:2]
        stopped.follower.hold_back(np.array([0]), stopped.poses[None, :1])
    # For as long as it stands it does not get ahead on its path; the other scene's walker does.
    for _ in range(40):
        stopped.walk()
        free.walk()
        np.testing.assert_allclose(stopped.poses[0], free.poses[0], atol=0.02)
    for _ in range(20):
        free.walk()
    np.testing.assert_array_equal(stopped.poses[1], free.poses[1])


@pytest.mark.parametrize("aside", [(0.3, -0.4), (0.0, 0.02)])
def test_a_walker_that_is_pushed_off_its_path_walks_back_at_its_speed(aside: tuple[float, float]) -> None:
    ground, speed = hills(), 1.0
    world = World("hills", ground, region=(-9.0, 9.0, -9.0, 9.0))
    walkers = Walkers(PathConf(waypoints=BEND.tolist()), world=world)
    walkers.walk(speed)
    walkers.poses[0, :2] += aside
    walkers.follower.hold_back(np.array([0]), walkers.poses[None, :1])
    track = [walkers.poses[0].copy()]
    for _ in range(30):
        walkers.walk(speed)
        track.append(walkers.poses[0].copy())
    track = np.array(track)
    steps = np.hypot(*np.diff(track[:, :2], axis=0).T)
    assert steps.max() < 1.01 * speed * STEP_S
    # Back on its path, and on the ground all the way.
    path = walkers.follower.paths(0)[0]
    assert np.hypot(*(path - track[0, :2]).T).min() > 0.015
    assert np.hypot(*(path - track[-1, :2]).T).min() < 0.03
    np.testing.assert_allclose(track[1:, 2], ground.height(track[1:, :2]), atol=0.01)


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("conf", "fault", "message"),
    [
        (PathConf, {"waypoints": ((0.0, 0.0),)}, "at least two points"),
        (PathConf, {"waypoints": ((0.0, 0.0), (5.0, 0.0), (5.0, 0.0))}, "waypoints"),
        (PathConf, {"length_range_m": (5.0, 4.0)}, "length_range_m must rise"),
        (PathConf, {"length_range_m": (0.5, 4.0)}, r"from at least 1\.0"),
        (PathConf, {"start_distance_m": -1.0}, "start_distance_m"),
        (PathConf, {"speed_mps": 1.0}, "speed_mps"),
        (PersonConf, {"height_m": 0.5, "radius_m": 0.25}, "more than twice radius_m"),
        (PersonConf, {"speed_mps": 0.0}, "speed_mps"),
        (PersonConf, {"speed_mps": 6.0}, "speed_mps"),
        (PersonConf, {"max_turn_radps": 0.0}, "max_turn_radps"),
        (PersonConf, {"speed": 1.0}, "speed"),
    ],
)
def test_faulty_settings_are_refused(conf: Any, fault: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        conf(**fault)
