"""Builds the agent groups of a simulation from their setups."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from dune_rl.behaviours.paths.follower import FollowPath, PathConf, PathFollower
from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.bodies.settings import BodySettings
from dune_rl.env.agent_group import AgentGroup, FileTrajectories, GroupSetup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.body import Body
from dune_rl.env.controllers import BehaviourController, Controller
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.presence import PresenceSchedule
from dune_rl.env.room import has_room, needs_in_words
from dune_rl.env.scene_manager import SceneManager
from dune_rl.env.sensing import sensor_context
from dune_rl.env.starts.paths import PathStarts, TrajectoryStarts
from dune_rl.env.starts.region import RegionStarts, Spawners, StartContext
from dune_rl.env.starts.source import StartSource
from dune_rl.env.state_builder import StateBuilder
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import MeasuringScan
from dune_rl.sensors.suite import SensorSuite
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.tasks.registry import START_SOURCES
from dune_rl.tasks.spawn import SpawnConf, SpawnedBody

# A new touch of the same body counts as a new collision after this long without one.
_COLLISION_GAP_S = 1.0
_ANY_DEPTH_M = 100.0


def build_groups(setups: Sequence[GroupSetup], scenes: SceneManager) -> tuple[AgentGroup, ...]:
    """The groups of M scenes, without their sensors, which see each other's groups: see `add_sensors`."""
    bodies = [_body(setups, index, scenes) for index in range(len(setups))]
    shared = _SharedParts(scenes)
    spawners = [shared.spawners(*each) for each in zip(setups, bodies, strict=True)]
    gap_steps = round(_COLLISION_GAP_S * scenes.conf.control_hz)
    groups = []
    for setup, body, own in zip(setups, bodies, spawners, strict=True):
        starts, moves = shared.starts(setup, body, own)
        rows = len(scenes.worlds) * setup.count
        group = AgentGroup(setup, body, starts, own, rows, gap_steps, _presence(setup, scenes))
        group.controller = moves
        groups.append(group)
    return tuple(groups)


def _body(setups: Sequence[GroupSetup], index: int, scenes: SceneManager) -> Body:
    """The bodies of a setup, numbered after those of the setups before."""
    setup, before = setups[index], setups[:index]
    is_kinematic = isinstance(setup.body, BodySettings)
    first = sum(one.count for one in before if isinstance(one.body, BodySettings) is is_kinematic)
    if isinstance(setup.body, BodySettings):
        return KinematicBody(
            setup.body,
            scenes.worlds,
            setup.count,
            scenes.conf.control_step_s,
            first=first,
            first_place=sum(one.count for one in before),
            is_prescribed=setup.is_scripted,
        )
    return ArticulatedBody(
        setup.body(len(scenes.worlds) * setup.count),
        scenes.conf,
        scenes.worlds,
        setup.count,
        first=first,
        has_latency=scenes.randomizer.randomizes_latency,
        measures_work=setup.metrics is not None and setup.metrics.energy,
    )


def _presence(setup: GroupSetup, scenes: SceneManager) -> PresenceSchedule | None:
    """When agents that come and go do so; None for all others."""
    if setup.presence is None:
        return None
    step_s = scenes.conf.control_step_s
    return PresenceSchedule(setup.presence, setup.name, len(scenes.worlds), setup.count, step_s)


class _SharedParts:
    """Builds what the groups share: spawners, each of which searches a whole world, and sources of starts.

    Random streams are named by a robot's number among all robots, by an agent's name, or for paths by the
    group's name, but for the first group on paths: a further group changes no draws of another.
    """

    def __init__(self, scenes: SceneManager) -> None:
        self._worlds = scenes.worlds.worlds
        self._spawners: dict[tuple[SpawnConf, float], Spawners] = {}
        self._robot_spawners: Spawners | None = None
        self._num_robots, self._num_on_paths = 0, 0
        # Other agents keep off robots, and robots take no notice of them.
        self._robots: list[RegionStarts] = []
        self._all: list[RegionStarts] = []

    def spawners(self, setup: GroupSetup, body: Body) -> Spawners:
        """The spawners of a group. Robots and agents on paths share those of equal footprint and settings."""
        spawn = SpawnConf() if setup.task is None else setup.task.spawn
        conf = setup.body
        if isinstance(conf, BodySettings) and setup.path is None:
            words = SpawnedBody(conf.name, needs_in_words(conf), setup.settings)
            passable, whose = partial(has_room, conf), f"{setup.name} ({conf.name}): "
            return Spawners(spawn, body.footprint_radius_m, self._worlds, passable, words, whose)
        if setup.path is not None:
            spawn = SpawnConf()
        key = spawn, body.footprint_radius_m
        if key not in self._spawners:
            self._spawners[key] = Spawners(*key, self._worlds)
        if not isinstance(conf, BodySettings) and self._robot_spawners is None:
            self._robot_spawners = self._spawners[key]
        return self._spawners[key]

    def starts(
        self, setup: GroupSetup, body: Body, spawners: Spawners
    ) -> tuple[StartSource, Controller | None]:
        """The starts of a group, and the controller that moves it along paths, if it is moved so."""
        if not isinstance(setup.body, BodySettings) or setup.path is None:
            return self._in_region(setup, body, spawners), None
        return self._on_path(setup, setup.path, setup.body, body, spawners)

    def _in_region(self, setup: GroupSetup, body: Body, spawners: Spawners) -> RegionStarts:
        spawn = SpawnConf() if setup.task is None else setup.task.spawn
        is_robot = body.description.is_robot
        names = tuple(f"{setup.name}_{agent}" for agent in range(setup.count))
        streams = tuple(f"spawn {name}" for name in names)
        if is_robot:
            numbers = range(self._num_robots, self._num_robots + setup.count)
            streams = tuple(f"spawn rover_{number}" if number else "spawn" for number in numbers)
            self._num_robots += setup.count
        context = StartContext(
            name="" if is_robot else setup.name,
            agents=names,
            is_robot=is_robot,
            worlds=self._worlds,
            spawners=spawners,
            position=lambda: body.motion.position_w,
            streams=streams,
            avoided=self._robots if is_robot else self._all,
            spawn=spawn,
        )
        starts: RegionStarts = START_SOURCES.build(spawn, context)
        if is_robot:
            self._all.append(starts)
        return starts

    def _on_path(
        self,
        setup: GroupSetup,
        path: PathConf | FileTrajectories,
        conf: BodySettings,
        body: Body,
        spawners: Spawners,
    ) -> tuple[StartSource, Controller | None]:
        radius_m, reach_m = body.description.radius_m, body.description.reach_m
        # Of the first group the streams keep the names that they had before there were several.
        suffix = f" {setup.name}" if self._num_on_paths else ""
        self._num_on_paths += 1
        if isinstance(path, FileTrajectories):
            on_file = TrajectoryFollower(setup.count, conf.speed_mps, self._worlds, setup.name, path.given)
            moves = BehaviourController(FollowPath(on_file))
            return TrajectoryStarts(on_file, setup.name, radius_m, reach_m), moves
        deepest = conf.max_water_m if conf.flight is None else _ANY_DEPTH_M
        follower = PathFollower(
            path, setup.count, conf.keep_out_radius_m, self._worlds, setup.settings, conf.speed_mps, deepest
        )
        # Random paths lead through the free space of robots, where there are any.
        through = self._robot_spawners or spawners
        starts = PathStarts(
            follower,
            through,
            setup.name,
            (f"paths{suffix}", f"actors{suffix}"),
            steers=not setup.is_scripted,
            reach_m=reach_m,
        )
        return starts, BehaviourController(FollowPath(follower)) if setup.is_scripted else None


def add_sensors(groups: Sequence[AgentGroup], builder: StateBuilder, scenes: SceneManager) -> None:
    """Give each group the sensors of its setup: one suite for all its agents."""
    meshes = {group.name: group.body.mesh() for group in groups}
    for group in groups:
        neighbours = [meshes[other.name] for other in builder.mesh_order(group)]
        suite = None
        if group.setup.sensors is not None:
            suite = SensorSuite(group.setup.sensors, _context(group, neighbours, scenes))
        scans = partial(_measuring_scan, group, neighbours, scenes)
        group.equip(suite, scans, partial(builder.forecast_neighbours, group))


def _measuring_scan(
    group: AgentGroup, neighbours: Sequence[MovingMesh], scenes: SceneManager
) -> MeasuringScan:
    return MeasuringScan(_context(group, neighbours, scenes))


def _carrier(group: AgentGroup) -> SensorCarrier:
    """The body as a carrier of sensors, with its model where its actions are a speed and a heading."""
    carrier = group.body.carrier()
    return replace(carrier, vehicle=group.body.vehicle()) if group.has_speed_and_heading else carrier


def _context(group: AgentGroup, neighbours: Sequence[MovingMesh], scenes: SceneManager) -> SensorContext:
    return sensor_context(
        scenes.worlds,
        _carrier(group),
        neighbours,
        num_rows=len(scenes.worlds) * group.count,
        step_s=scenes.conf.control_step_s,
        action_size=group.action_size,
        extent=scenes.extent,
        worlds_differ=scenes.randomizer.randomizes_worlds,
    )
