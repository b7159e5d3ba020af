"""Environments built from settings: the one place that names concrete classes."""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, partial

from dune_rl.config.schema import EnvConf, RobotConf, SingleAgentConf
from dune_rl.env.batch import Batch
from dune_rl.env.gymnasium import GymnasiumEnv
from dune_rl.env.pettingzoo import ParallelDuneEnv, RenderMode
from dune_rl.env.torchrl import DuneEnv
from dune_rl.env.variety import Variety
from dune_rl.errors import ConfigError
from dune_rl.physics.interface import Engine, PhysicsScene, SceneSpec
from dune_rl.robots.hyperdog.robot import HyperDog, HyperDogConf
from dune_rl.robots.leo_rover.robot import LeoRover, LeoRoverConf
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.robots.urdf.robot import UrdfConf, UrdfRobot
from dune_rl.worlds.cache.store import shared_store
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World


def make_batch(
    conf: EnvConf,
    num_scenes: int,
    seed: int,
    *,
    world_of: Callable[[WorldSettings], World] | None = None,
    prepare: Callable[[Sequence[WorldSettings]], None] | None = None,
) -> Batch:
    """The batch core of `num_scenes` scenes; raises `WorldError` where no start or goal can be found.

    `world_of` gives the worlds instead of `build_world`, and `prepare`, instead
    of `prepare_worlds`, is told which ones the next episodes will ask it for.
    """
    world_of = build_world if world_of is None else world_of
    prepare = partial(prepare_worlds, seen="camera" in conf.sensors.enabled) if prepare is None else prepare
    first, *others = (partial(build_robot, robot) for robot in conf.all_robots)
    return Batch(
        world=world_of(conf.world),
        make_robot=first,
        make_others=tuple(others),
        make_scene=scene_class(conf.physics.backend),
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        weather=conf.weather,
        variety=Variety(conf.world, conf.weather, conf.randomisation, world_of, prepare),
        num_scenes=num_scenes,
        seed=seed,
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
    """A TorchRL environment of batch size (num_scenes,); `ConfigError` where a scene has several robots."""
    if len(conf.all_robots) > 1:
        raise ConfigError("robots are agents of parallel_env alone; choose one here: robot=NAME")
    return DuneEnv(make_batch(conf, num_scenes, seed))


def make_parallel_env(conf: EnvConf, seed: int, render_mode: RenderMode = None) -> ParallelDuneEnv:
    """A PettingZoo environment of one scene."""
    return ParallelDuneEnv(make_batch(conf, 1, seed), render_mode)


def make_gymnasium_env(conf: SingleAgentConf, seed: int, render_mode: RenderMode = None) -> GymnasiumEnv:
    """A Gymnasium environment of one scene's rover."""
    return GymnasiumEnv(make_batch(conf, 1, seed), render_mode)
