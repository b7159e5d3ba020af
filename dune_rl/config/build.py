"""Environments built from settings: the one place that names concrete classes."""

from functools import lru_cache

from dune_rl.config.schema import EnvConf, RobotConf, SingleAgentConf, WorldConf
from dune_rl.env.batch import Batch
from dune_rl.env.gymnasium import GymnasiumEnv
from dune_rl.env.pettingzoo import ParallelDuneEnv, RenderMode
from dune_rl.env.torchrl import DuneEnv
from dune_rl.physics.bullet import BulletScene
from dune_rl.robots.hyperdog import HyperDog, HyperDogConf
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.urdf_robot import UrdfConf, UrdfRobot
from dune_rl.worlds.construction import ConstructionConf, build_construction
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.importing.heightmap import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.imported_mesh import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf import SdfConf, build_sdf
from dune_rl.worlds.inspection import InspectionConf, build_inspection
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.rubicon import RubiconConf, build_rubicon
from dune_rl.worlds.world import World


def make_batch(conf: EnvConf, num_scenes: int, seed: int) -> Batch:
    """The batch core of `num_scenes` scenes; raises `WorldError` where no start or goal can be found."""
    return Batch(
        world=build_world(conf.world),
        make_robot=lambda scenes: build_robot(conf.robot, scenes),
        make_scene=BulletScene,
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        weather=conf.weather,
        num_scenes=num_scenes,
        seed=seed,
    )


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
def build_world(conf: WorldConf) -> World:
    """The world; equal settings share one, which nothing ever changes."""
    match conf:
        case FlatConf():
            return build_flat(conf)
        case InspectionConf():
            return build_inspection(conf)
        case ConstructionConf():
            return build_construction(conf)
        case RubiconConf():
            return build_rubicon(conf)
        case IslandConf():
            return build_island(conf)
        case MeshConf():
            return build_mesh(conf)
        case HeightmapConf():
            return build_heightmap(conf)
        case SdfConf():
            return build_sdf(conf)


def make_torchrl_env(conf: EnvConf, num_scenes: int, seed: int) -> DuneEnv:
    """A TorchRL environment of batch size (num_scenes,)."""
    return DuneEnv(make_batch(conf, num_scenes, seed))


def make_parallel_env(conf: EnvConf, seed: int, render_mode: RenderMode = None) -> ParallelDuneEnv:
    """A PettingZoo environment of one scene."""
    return ParallelDuneEnv(make_batch(conf, 1, seed), render_mode)


def make_gymnasium_env(conf: SingleAgentConf, seed: int, render_mode: RenderMode = None) -> GymnasiumEnv:
    """A Gymnasium environment of one scene's rover."""
    return GymnasiumEnv(make_batch(conf, 1, seed), render_mode)
