"""Environments built from settings: the one place that names concrete classes."""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, partial

from dune_rl.behaviours.path_follower import PathConf
from dune_rl.bodies.person import PersonConf
from dune_rl.config.actors import ActorConf
from dune_rl.config.schema import EnvConf, RobotConf, SingleAgentConf
from dune_rl.env.agent_group import GroupSetup
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.gymnasium import GymnasiumEnv
from dune_rl.env.pettingzoo import ParallelDuneEnv, RenderMode
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import DuneEnv
from dune_rl.physics.interface import Engine, PhysicsScene, SceneSpec
from dune_rl.robots.hyperdog.robot import HyperDog, HyperDogConf
from dune_rl.robots.leo_rover.robot import LeoRover, LeoRoverConf
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.robots.urdf.robot import UrdfConf, UrdfRobot
from dune_rl.sensors.suite import SensorsConf
from dune_rl.tasks.task import walking_task
from dune_rl.worlds.cache.store import shared_store
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World


def make_simulation(
    conf: EnvConf,
    num_scenes: int,
    seed: int,
    *,
    world_of: Callable[[WorldSettings], World] | None = None,
    prepare: Callable[[Sequence[WorldSettings]], None] | None = None,
) -> VectorSimulation:
    """The core of `num_scenes` scenes; raises `WorldError` where no start or goal can be found.

    `world_of` gives the worlds instead of `build_world`, and `prepare`, instead of `prepare_worlds`, is
    given the settings of those that the next episodes will be in.
    """
    world_of = build_world if world_of is None else world_of
    prepare = partial(prepare_worlds, seen="camera" in conf.sensors.enabled) if prepare is None else prepare
    return VectorSimulation(
        world=world_of(conf.world),
        groups=group_setups(conf),
        make_scene=scene_class(conf.physics.backend),
        physics=conf.physics,
        weather=conf.weather,
        randomizer=DomainRandomizer(conf.world, conf.weather, conf.randomisation, world_of, prepare),
        num_scenes=num_scenes,
        seed=seed,
    )


def group_setups(conf: EnvConf) -> list[GroupSetup]:
    """The agent groups of a scene."""
    groups: list[GroupSetup] = []
    robots: dict[RobotConf, int] = {}
    for robot in conf.all_robots:
        robots[robot] = robots.get(robot, 0) + 1
    for robot, count in robots.items():
        name = "rover" if robot.name == "rover_zero" else robot.name
        groups.append(
            GroupSetup(
                name,
                count,
                partial(build_robot, robot),
                sensors=conf.sensors,
                task=conf.task,
                metrics=conf.metrics,
            )
        )
    walkers: dict[ActorConf, int] = {}
    for actor in conf.actors:
        walkers[actor] = walkers.get(actor, 0) + 1
    for index, (actor, count) in enumerate(walkers.items()):
        external = actor.controller == "external"
        groups.append(
            GroupSetup(
                "walker" if not index else f"walker_{'abcdefg'[index]}",
                count,
                PersonConf(speed_mps=actor.speed_mps, radius_m=actor.radius_m, height_m=actor.height_m),
                paths=PathConf(
                    waypoints=actor.waypoints,
                    length_range_m=actor.length_range_m,
                    start_distance_m=actor.start_distance_m,
                ),
                follows_paths=not external,
                sensors=WALKER_SENSORS if external else None,
                task=walking_task() if external else None,
            )
        )
    return groups


WALKER_SENSORS = SensorsConf(
    enabled=("goal", "nearest_agent", "velocity"), named={"velocity": {"sensor": "planar_velocity"}}
)


def scene_class(backend: Engine) -> Callable[[SceneSpec], PhysicsScene]:
    """What makes scenes of the engine of this name; raises `PhysicsError` if it is not installed."""
    # An engine is loaded when it is asked for: one may be missing.
    match backend:
        case "bullet":
            from dune_rl.physics.bullet.scene import BulletScene

            return BulletScene
        case "dart":
            from dune_rl.physics.dart.scene import DartScene

            return DartScene


def build_robot(conf: RobotConf, num_scenes: int) -> Robot:
    """`num_scenes` robots of the kind that `conf` is of."""
    match conf:
        case RoverZeroConf():
            return RoverZero(conf, num_scenes)
        case LeoRoverConf():
            return LeoRover(conf, num_scenes)
        case HyperDogConf():
            return HyperDog(conf, num_scenes)
        case UrdfConf():
            return UrdfRobot(conf, num_scenes)


@lru_cache(maxsize=4)
def build_world(conf: WorldSettings) -> World:
    """The world; equal settings share one, which nothing ever changes."""
    return shared_store().get(conf)


def prepare_worlds(confs: Iterable[WorldSettings], *, seen: bool = False) -> None:
    """Have worlds built in the background that `build_world` will be asked for (`WorldStore.prepare`)."""
    shared_store().prepare(confs, seen=seen)


def make_torchrl_env(conf: EnvConf, num_scenes: int, seed: int) -> DuneEnv:
    """A TorchRL environment of batch size (num_scenes,)."""
    return DuneEnv(make_simulation(conf, num_scenes, seed))


def make_parallel_env(conf: EnvConf, seed: int, render_mode: RenderMode = None) -> ParallelDuneEnv:
    """A PettingZoo environment of one scene."""
    return ParallelDuneEnv(make_simulation(conf, 1, seed), render_mode)


def make_gymnasium_env(conf: SingleAgentConf, seed: int, render_mode: RenderMode = None) -> GymnasiumEnv:
    """A Gymnasium environment of one scene's rover."""
    return GymnasiumEnv(make_simulation(conf, 1, seed), render_mode)
