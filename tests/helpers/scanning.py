"""Worlds of a few boxes, LiDARs in them, and other sensors."""

import numpy as np
from people import meshes_of
from scenes import about
from sensor_contexts import context_of
from sensors_of_rover_zero import lidar_conf
from states import group_state, measure

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.rays import RayScene
from dune_rl.sensors.lidar import Lidar, LidarConf
from dune_rl.sensors.own_motion import Velocity, VelocityConf
from dune_rl.state import Motion
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

# Farther than any of these instruments sees; a large ground takes long to colour.
SIZE_M = 65.0


def flat_with(*boxes: tuple[float, float, float, float, float]) -> World:
    """A plane with boxes (x, y, yaw, length, width), each 1 m high."""
    props = [
        Prop(f"box_{i}", "box", *upright_box((x, y), yaw, -0.1, 1.0, length, width))
        for i, (x, y, yaw, length, width) in enumerate(boxes)
    ]
    ground = build_flat(FlatConf(size_m=SIZE_M))
    return World("test", ground.terrain, props, region=ground.region)


def lidar_in(world: World, actors: tuple[PersonConf, ...] = (), conf: LidarConf | None = None) -> Lidar:
    solid = world.solid_mesh()
    return Lidar(
        conf or lidar_conf(),
        RayScene(solid.vertices, solid.faces),
        meshes_of(actors),
    )


def sensed_speed(motion: Motion) -> np.ndarray:
    """The reading "velocity" of a motion."""
    sensor = Velocity("velocity", context_of(), VelocityConf())
    measure(sensor, group_state(motion))
    return sensor.read()["velocity"]


def turned(yaw: float) -> np.ndarray:
    return rotation_matrices(about([0, 0, 1], yaw))
