"""Worlds built from mesh files, for tests."""

from dune_rl.config.compose import compose_environment
from dune_rl.env.batch import Batch
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.robots.rover_zero.robot import RoverZero

FORMATS = ("obj", "stl", "ply", "glb", "dae")


def batch_in(world) -> Batch:
    conf = compose_environment("flat", (), {"actors": "none"})
    batch = Batch(
        world=world,
        make_robot=lambda scenes: RoverZero(conf.robot, scenes),
        make_scene=BulletScene,
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        num_scenes=1,
        seed=3,
    )
    batch.reset()
    return batch
