"""Builds the agent groups of a simulation from their setups."""

from collections.abc import Sequence
from functools import partial

from dune_rl.behaviours.paths.follower import PathConf, PathFollower
from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.bodies.settings import BodySettings
from dune_rl.env.agent_group import AgentGroup, GroupSetup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.goals import GoalTracker, PathGoals, RegionGoals, Spawners
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.room import has_room, needs_in_words
from dune_rl.env.scene_manager import SceneBodies, SceneManager
from dune_rl.env.sensing import sensor_context
from dune_rl.env.state_builder import StateBuilder
from dune_rl.env.visits import Visits
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.measuring_scan import MeasuringScan
from dune_rl.sensors.suite import SensorSuite
from dune_rl.tasks.spawn import SpawnConf
from dune_rl.tasks.spawned_body import SpawnedBody
from dune_rl.worlds.world import World

# A new touch of the same body counts as a new collision after this long without one.
_COLLISION_GAP_S = 1.0
_ANY_DEPTH_M = 100.0


def build_groups(setups: Sequence[GroupSetup], scenes: SceneManager) -> tuple[AgentGroup, ...]:
    """The groups of M scenes, without their sensors, which see each other's groups: see `add_sensors`."""
    groups: list[AgentGroup] = []
    robots: list[RegionGoals] = []
    roaming: list[RegionGoals] = []
    spawners = _SharedSpawners(scenes.worlds.worlds)
    parking = 0
    for setup in setups:
        if not isinstance(setup.body, BodySettings):
            group = _robot_group(setup, scenes, spawners, robots)
        elif setup.paths is not None or setup.follows_trajectories:
            group = _group_on_paths(setup, setup.body, scenes, parking, spawners)
        else:
            group = _roaming_group(setup, setup.body, scenes, parking, roaming)
        groups.append(group)
        parking += setup.count
    # Other agents keep off robots, and robots take no notice of them.
    roaming[:0] = robots
    return tuple(groups)


class _SharedSpawners:
    """One `Spawners` for all groups of equal footprint and spawn settings: each searches a whole world."""

    def __init__(self, worlds: SharedPerScene[World]) -> None:
        self._worlds = worlds
        self._known: dict[tuple[SpawnConf, float], Spawners] = {}

    def of(self, conf: SpawnConf, radius_m: float) -> Spawners:
        """The spawners of footprints of `radius_m`."""
        if (conf, radius_m) not in self._known:
            self._known[conf, radius_m] = Spawners(conf, radius_m, self._worlds)
        return self._known[conf, radius_m]


def _gap_steps(scenes: SceneManager) -> int:
    return round(_COLLISION_GAP_S * scenes.conf.control_hz)


def _robot_group(
    setup: GroupSetup,
    scenes: SceneManager,
    shared_spawners: _SharedSpawners,
    robots: list[RegionGoals],
) -> AgentGroup:
    assert not isinstance(setup.body, BodySettings)
    rows = len(scenes.worlds) * setup.count
    robot = setup.body(rows)
    spawn = SpawnConf() if setup.task is None else setup.task.spawn
    body = ArticulatedBody(
        robot,
        scenes.conf,
        scenes.worlds,
        setup.count,
        has_latency=scenes.randomizer.randomizes_latency,
        measures_work=setup.metrics is not None and setup.metrics.energy,
    )
    spawners = shared_spawners.of(spawn, robot.footprint_radius_m)
    goals = RegionGoals(
        spawn,
        robot.footprint_radius_m,
        spawners,
        len(scenes.worlds),
        setup.count,
        lambda: body.motion.position_w,
        robots,
    )
    return AgentGroup(setup, body, GoalTracker(goals, rows), spawners, rows, _gap_steps(scenes))


def _group_on_paths(
    setup: GroupSetup,
    conf: BodySettings,
    scenes: SceneManager,
    first_place: int,
    shared_spawners: _SharedSpawners,
) -> AgentGroup:
    body = KinematicBody(conf, scenes.worlds, setup.count, scenes.conf.control_step_s, first_place)
    worlds = scenes.worlds.worlds
    follower: PathFollower | TrajectoryFollower
    if setup.follows_trajectories:
        follower = TrajectoryFollower(setup.count, conf.speed_mps, worlds, setup.name, setup.trajectories)
    else:
        radius, paths = conf.keep_out_radius_m, setup.paths or PathConf()
        deepest = conf.max_water_m if conf.flight is None else _ANY_DEPTH_M
        where = setup.settings or f"actors.{setup.name}"
        follower = PathFollower(paths, setup.count, radius, worlds, where, conf.speed_mps, deepest)
    spawners = shared_spawners.of(SpawnConf(), conf.keep_out_radius_m)
    rows = len(scenes.worlds) * setup.count
    goals = GoalTracker(PathGoals(follower), rows)
    return AgentGroup(setup, body, goals, spawners, rows, _gap_steps(scenes), _visits(setup, scenes))


def _visits(setup: GroupSetup, scenes: SceneManager) -> Visits | None:
    """The visits of agents that come and go; None for all others."""
    if setup.presence is None:
        return None
    return Visits(setup.presence, setup.name, len(scenes.worlds), setup.count, scenes.conf.control_step_s)


def _roaming_group(
    setup: GroupSetup, conf: BodySettings, scenes: SceneManager, first_place: int, roaming: list[RegionGoals]
) -> AgentGroup:
    body = KinematicBody(conf, scenes.worlds, setup.count, scenes.conf.control_step_s, first_place)
    spawn = SpawnConf() if setup.task is None else setup.task.spawn
    radius, worlds = conf.keep_out_radius_m, scenes.worlds.worlds
    body_in_words = SpawnedBody(conf.name, needs_in_words(conf), setup.settings)
    spawners = Spawners(
        spawn, radius, worlds, partial(has_room, conf), body_in_words, f"{setup.name} ({conf.name}): "
    )
    goals = RegionGoals(
        spawn,
        radius,
        spawners,
        len(scenes.worlds),
        setup.count,
        lambda: body.motion.position_w,
        roaming,
        setup.name,
    )
    rows = len(scenes.worlds) * setup.count
    tracker = GoalTracker(goals, rows)
    return AgentGroup(setup, body, tracker, spawners, rows, _gap_steps(scenes), _visits(setup, scenes))


def add_sensors(groups: Sequence[AgentGroup], builder: StateBuilder, scenes: SceneManager) -> None:
    """Give each group the sensors of its setup: one suite for all its agents."""
    meshes = {group.name: group.body.mesh() for group in groups}
    for group in groups:
        neighbours = [meshes[other.name] for other in builder.mesh_order(group)]
        suite = None
        if group.setup.sensors is not None:
            suite = SensorSuite(group.setup.sensors, _context(group, neighbours, scenes))
        group.equip(suite, partial(_measuring_scan, group, neighbours, scenes))


def _measuring_scan(
    group: AgentGroup, neighbours: Sequence[MovingMesh], scenes: SceneManager
) -> MeasuringScan:
    return MeasuringScan(_context(group, neighbours, scenes))


def _context(group: AgentGroup, neighbours: Sequence[MovingMesh], scenes: SceneManager) -> SensorContext:
    return sensor_context(
        scenes.worlds,
        group.body.carrier(),
        neighbours,
        num_rows=len(scenes.worlds) * group.count,
        step_s=scenes.conf.control_step_s,
        worlds_differ=scenes.randomizer.randomizes_worlds,
    )


def scene_bodies(groups: Sequence[AgentGroup]) -> SceneBodies:
    """What the groups put into each scene's physics."""
    robots, kinematics = [], []
    for group in groups:
        for name in group.names:
            if isinstance(group.body, ArticulatedBody):
                robots.append(group.body.robot.body)
            elif isinstance(group.body, KinematicBody):
                kinematics.append(group.body.conf.collision_shape(name))
    return SceneBodies(tuple(robots), tuple(kinematics))
