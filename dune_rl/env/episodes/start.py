"""Starts an episode in a scene: world, start poses, goals, and settling of the robots."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations

import numpy as np

from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.episodes.request import EpisodeRequest
from dune_rl.env.given_points import check_places
from dune_rl.env.goals import PLACING_ATTEMPTS, PathGoals, RegionGoals, place_groups
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.scene_manager import SceneManager
from dune_rl.env.scene_spec import standing_pose
from dune_rl.env.turnover import discs_of, park_absent
from dune_rl.geometry.arrays import Array
from dune_rl.physics.interface import PhysicsRobot
from dune_rl.tasks.spawn import Placement
from dune_rl.worlds.world import World

# Of kinematic bodies in physics: x, y, z, yaw, roll and pitch.
_POSE_COLUMNS = 6


class EpisodeStart:
    """Samples start poses of all agents of a scene: first robots, then others, away from them."""

    def __init__(self, groups: Sequence[AgentGroup], scenes: SceneManager) -> None:
        self._groups, self._scenes = groups, scenes
        self._robots = [group for group in groups if isinstance(group.body, ArticulatedBody)]
        self._kinematic = [group for group in groups if isinstance(group.body, KinematicBody)]

    def check_room(self, seed: int, world: World) -> None:
        """Raise `WorldError` if `world` has no room for a robot or a path. This also finds the paths."""
        with_starts = [partial(group.spawners.of, world) for group in (*self._robots, *self._roaming)]
        _check_all([*with_starts, *self._path_searches(seed, world)])

    def check_places(self, world: World, *, only_edge: bool) -> None:
        """Raise `WorldError` if bodies are sent to places where they cannot be; see `given_points`."""
        _check_all([partial(check_places, group, world, only_edge=only_edge) for group in self._kinematic])

    def check_counts(self, seed: int, world: World) -> None:
        """Raise `WorldError` if `world` has no room for all agents beside each other.

        It is that of the last of a few episodes, in none of which all could be placed. Agents that come
        later are not counted: they wait until there is room.
        """
        groups = [group for group in (*self._robots, *self._roaming) if group.is_there_at_start]
        for episode in range(PLACING_ATTEMPTS):
            taken = self.starts_on_trajectories(world)
            try:
                for group in groups:
                    assert isinstance(group.goals.source, RegionGoals)
                    taken = group.goals.source.try_placing(world, seed, episode, taken)
                return
            except WorldError:
                if episode == PLACING_ATTEMPTS - 1:
                    raise

    def find_paths(self, seed: int, world: World) -> None:
        """Find the paths of `world` for all groups on paths."""
        _check_all(self._path_searches(seed, world))

    def _path_searches(self, seed: int, world: World) -> list[Callable[[], object]]:
        return [
            partial(self._find_paths_of, index, group, seed, world)
            for index, group in enumerate(self._on_paths())
        ]

    def _find_paths_of(self, index: int, group: AgentGroup, seed: int, world: World) -> None:
        sample_points = (self._robots[0] if self._robots else group).spawners.of(world).sample_points
        draws = stream(seed, f"paths {group.name}" if index else "paths")
        assert isinstance(group.goals.source, PathGoals)
        group.goals.source.follower.find_paths(world, sample_points, draws)

    def replan_paths(self, seed: int, world: World) -> None:
        """Drop all paths and find those of `world` with another `seed`."""
        for group in self._on_paths():
            assert isinstance(group.goals.source, PathGoals)
            group.goals.source.follower.clear_paths()
        self.find_paths(seed, world)

    def _on_paths(self) -> list[AgentGroup]:
        return [group for group in self._kinematic if isinstance(group.goals.source, PathGoals)]

    @property
    def _roaming(self) -> list[AgentGroup]:
        return [group for group in self._kinematic if isinstance(group.goals.source, RegionGoals)]

    def start(self, scene: int, seed: int, episode: int, request: EpisodeRequest) -> None:
        """Start an episode in a scene; raises `WorldError` if there is no room.

        `request` has starts and goals of robots in place of sampled ones; raises ValueError if they are not
        free, or not of robots.
        """
        scenes = self._scenes
        world = scenes.enter(scene, seed, episode, partial(self.check_room, seed))
        if scenes.randomizer.randomizes_worlds:
            used = scenes.used_worlds()
            for group in self._groups:
                group.spawners.keep(used)
        for group in self._kinematic:
            if group.visits is not None:
                group.visits.begin(scene, seed, episode)
        starts, taken = self._place_robots(scene, world, seed, episode, request)
        avoid = np.array([position[:2] for poses in starts for position, _ in poses]).reshape(-1, 2)
        avoid = np.concatenate([avoid, self._place_roaming(scene, seed, episode, taken)])
        self._place_on_paths(scene, seed, episode, avoid)
        scenes.reset(scene, self.kinematic_poses()[scene])
        self._reset_contacts(scene, world, starts)
        scenes.settle(scene)

    def _place_on_paths(self, scene: int, seed: int, episode: int, avoid: Array) -> None:
        """Place the agents that start on paths, away from the points `avoid` (R, 2).

        Those who steer start beside each other and beside those who are moved along their paths, who may
        overlap.
        """
        numbered = list(enumerate(self._on_paths()))
        discs = np.zeros((0, 3))
        for index, group in sorted(numbered, key=lambda one: not one[1].setup.is_scripted):
            assert isinstance(group.goals.source, PathGoals)
            assert isinstance(group.body, KinematicBody)
            draws = stream(seed, f"actors {group.name}" if index else "actors", episode)
            follower = group.goals.source.follower
            if isinstance(follower, TrajectoryFollower) or group.setup.is_scripted:
                poses = follower.reset(scene, draws, avoid)
            else:
                poses = follower.reset_apart(scene, draws, avoid, discs, group.description.reach_m)
            group.body.place(scene, poses)
            park_absent(group, scene)
            discs = np.concatenate([discs, discs_of(group, scene)])

    def _place_robots(
        self, scene: int, world: World, seed: int, episode: int, request: EpisodeRequest
    ) -> tuple[list[list[tuple[Array, Array]]], list[tuple[Placement, float]]]:
        """Sample start poses, by group, and goals of the robots, or take those of `request`.

        Returns also what is taken by them and by actors on trajectories. Robots whose starts are requested
        are placed first, and the others at a distance from them and from where actors on trajectories start.
        """
        robots = [name for group in self._robots for name in group.names]
        others = [name for name in request if name not in robots]
        if others:
            raise ValueError(f"{', '.join(others)}: only robots start and go where they are told")
        placed: dict[str, tuple[Placement, float]] = {}
        actors = self.starts_on_trajectories(world)

        def place(group: AgentGroup, agent: int, name: str, taken: Sequence[tuple[Placement, float]]) -> None:
            source = group.goals.source
            assert isinstance(source, RegionGoals)
            placement = source.place_agent(scene, seed, episode, agent, taken)
            if name in request:
                asked, has_goal = request[name].applied(placement), request[name].goal is not None
                placement = source.move(scene, agent, name, asked, has_goal=has_goal)
            placed[name] = placement, source.footprint_radius_m

        members = [(group, agent, name) for group in self._robots for agent, name in enumerate(group.names)]
        starts_given = {name for name, asked in request.items() if asked.start is not None}
        for group, agent, name in members:
            if name in starts_given:
                place(group, agent, name, ())
        for group, agent, name in members:
            if name not in starts_given:
                place(group, agent, name, (*actors, *placed.values()))
        found = []
        for group, engines in zip(self._robots, self._engines_of(scene), strict=True):
            body = group.body
            assert isinstance(body, ArticulatedBody)
            placements = [placed[name][0] for name in group.names]
            poses = [standing_pose(world, body.robot, one.x, one.y, one.yaw) for one in placements]
            for engine, (position, quaternion) in zip(engines, poses, strict=True):
                engine.set_start_pose(position.tolist(), quaternion.tolist())
            found.append(poses)
        if request:
            _check_apart([(name, *placed[name]) for _, _, name in members])
        return found, [*actors, *placed.values()]

    def _place_roaming(
        self, scene: int, seed: int, episode: int, taken: list[tuple[Placement, float]]
    ) -> Array:
        """Place kinematic bodies without paths, away from those `taken`; returns their outlines (P, 2)."""
        points = [np.zeros((0, 2))]
        here = [group.agents_of(scene) for group in self._roaming]
        sources = [group.goals.source for group in self._roaming]
        found = place_groups(list(zip(sources, here, strict=True)), scene, seed, episode, taken)
        for group, agents, placed in zip(self._roaming, here, found, strict=True):
            assert isinstance(group.body, KinematicBody)
            poses = np.zeros((group.count, 4))
            poses[agents] = np.array([(one.x, one.y, 0.0, one.yaw) for one in placed]).reshape(-1, 4)
            poses[:, 2] = self._scenes.worlds.worlds[scene].terrain.height(poses[:, :2])
            group.body.place(scene, group.body.turned_to_free_way(scene, poses))
            park_absent(group, scene)
            points.append(group.body.outline_points(scene))
        return np.concatenate(points)

    def starts_on_trajectories(self, world: World) -> list[tuple[Placement, float]]:
        """Where actors on trajectories start, as placements that stay there, and their radii [m]."""
        starts = []
        for group in self._on_paths():
            assert isinstance(group.goals.source, PathGoals)
            follower = group.goals.source.follower
            if isinstance(follower, TrajectoryFollower):
                for x, y, _, yaw in follower.start_poses(world).tolist():
                    starts.append((Placement(x, y, yaw, x, y), group.description.radius_m))
        return starts

    def _reset_contacts(self, scene: int, world: World, starts: list[list[tuple[Array, Array]]]) -> None:
        variation = self._scenes.randomizer.variation(self._scenes.values[scene])
        for group, engines, poses in zip(self._robots, self._engines_of(scene), starts, strict=True):
            body = group.body
            assert isinstance(body, ArticulatedBody)
            for agent, (engine, pose) in enumerate(zip(engines, poses, strict=True)):
                row = scene * group.count + agent
                body.traction.set_factors(row, variation.contacts)
                if body.latency is not None:
                    body.latency.set_delay(row, variation.latency_s or 0.0)
                body.reset_contacts(row, engine, world, pose)

    def _engines_of(self, scene: int) -> list[list[PhysicsRobot]]:
        robots = iter(self._scenes.robots(scene))
        return [[next(robots) for _ in range(group.count)] for group in self._robots]

    def engines(self) -> dict[str, list[PhysicsRobot]]:
        """The physics robots of each group, rows scene after scene; `start` may replace them."""
        found: dict[str, list[PhysicsRobot]] = {group.name: [] for group in self._groups}
        for scene in range(len(self._scenes.worlds)):
            if self._scenes.is_built(scene):
                for group, engines in zip(self._robots, self._engines_of(scene), strict=True):
                    found[group.name] += engines
        return found

    def hold_back(self, held: Mapping[int, Array]) -> None:
        """Set the kinematic bodies of scenes to `held` (K, 6), by scene, where robots blocked them."""
        if not held:
            return
        scenes, poses = np.array(list(held)), np.array(list(held.values()))
        first = 0
        for group in self._kinematic:
            group.hold_back(scenes, poses[:, first : first + group.count])
            first += group.count

    def kinematic_poses(self) -> Array:
        """Poses (M, K, 6) of all kinematic bodies, in the order of their groups."""
        scenes = len(self._scenes.worlds)
        poses = np.zeros((scenes, sum(group.count for group in self._kinematic), _POSE_COLUMNS))
        first = 0
        for group in self._kinematic:
            own = group.body.poses
            # Bodies that never lean leave out roll and pitch.
            poses[:, first : first + group.count, : own.shape[1]] = own.reshape(scenes, group.count, -1)
            first += group.count
        return poses


def _check_all(checks: Sequence[Callable[[], object]]) -> None:
    """Make all `checks`, and raise one `WorldError` with the faults of those that did."""
    faults = []
    for check in checks:
        try:
            check()
        except WorldError as error:
            faults.append(str(error))
    if faults:
        raise WorldError("\n".join(dict.fromkeys(faults)))


def _check_apart(placed: Sequence[tuple[str, Placement, float]]) -> None:
    """Raise ValueError if two robots, by name, placement and footprint radius [m], start in one another."""
    for (one, first, radius), (other, second, other_radius) in combinations(placed, 2):
        if math.hypot(first.x - second.x, first.y - second.y) < radius + other_radius:
            raise ValueError(
                f"{one} and {other} would start in one another, at ({first.x:g}, {first.y:g}) and "
                f"({second.x:g}, {second.y:g}): give both of them starts that are apart"
            )
