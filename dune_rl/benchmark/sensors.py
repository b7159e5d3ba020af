"""What sensors cost, in comparison with the physics engine's own rays and pictures."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.shapes import actor_moving_meshes
from dune_rl.benchmark.environment import median_ratio, seconds
from dune_rl.config.build import make_batch
from dune_rl.config.schema import BenchmarkConf
from dune_rl.env.batch import Batch
from dune_rl.env.pictures import Pictures
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.bullet.reference import BulletReference
from dune_rl.physics.interface import StaticBody
from dune_rl.rendering.light import LightConf
from dune_rl.sensors.camera import Camera, CameraConf
from dune_rl.sensors.lidar import Lidar, beam_angles
from dune_rl.worlds.appearance import bake_world
from dune_rl.worlds.world import World

Array = NDArray[np.float64]

_GRID, _GRID_SPACING_M = 256, 0.25


def measure_sensors(conf: BenchmarkConf) -> dict[str, Any]:
    """Times per scene [µs] of LiDAR and camera, ratios to PyBullet's, and a large picture's time [s].

    Above 1 means that ours is faster. Both see the same places from the same poses.
    """
    batch = make_batch(conf, conf.scenes, conf.seed)
    batch.reset()
    world = batch.world
    statics = [StaticBody("ground", *world.terrain.mesh(), 1.0, ground=True)]
    statics += [StaticBody(prop.name, prop.vertices, prop.faces, 1.0, ground=False) for prop in world.props]
    reference = BulletReference(statics)
    lidar = _lidar(conf, batch, reference)
    camera = _camera(conf, world, batch, reference)
    reference.close()
    grid = HeightField(_hills(_GRID), _GRID_SPACING_M, (-_GRID_SPACING_M * (_GRID - 1) / 2,) * 2)
    field = World("hills", grid, region=(-5.0, 5.0, -5.0, 5.0))
    heights = BulletReference(heights=grid.heights, spacing_m=_GRID_SPACING_M)
    hills = _camera(conf, field, batch, heights)
    heights.close()
    pictures = Pictures(batch)
    large = partial(pictures.from_behind, 0, 1280, 720)
    seconds(large, 1)
    found = {
        "lidar_us": lidar["ours"],
        "lidar_speedup": lidar["speedup"],
        "camera_us": camera["ours"],
        "camera_speedup": camera["speedup"],
        "camera_speedup_heightfield": hills["speedup"],
        "picture_1280x720_s": float(np.median([seconds(large, 1) for _ in range(min(5, conf.rounds))])),
    }
    batch.close()
    return found


def _lidar(conf: BenchmarkConf, batch: Batch, reference: BulletReference) -> dict[str, float]:
    solid = batch.world.solid_mesh()
    lidar = Lidar(batch.sensors.lidar, RayScene(solid.vertices, solid.faces), [])
    nobody = np.zeros((conf.scenes, 0, 4))
    position, rotation = batch.motion.position_w, batch.motion.rotation
    angles = beam_angles(conf.sensors.lidar)
    beams = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    origin = lidar.origin(position, rotation)
    ends = origin[:, None] + conf.sensors.lidar.range_m * beams @ rotation.transpose(0, 2, 1)
    asked = [([start.tolist()] * len(beams), end.tolist()) for start, end in zip(origin, ends, strict=True)]

    def theirs() -> None:
        for starts, stops in asked:
            reference.cast(starts, stops)

    return _compared(conf, partial(lidar.ranges, position, rotation, nobody), theirs)


def _camera(conf: BenchmarkConf, world: World, batch: Batch, reference: BulletReference) -> dict[str, float]:
    camera = Camera(CameraConf(), bake_world(world, LightConf()), actor_moving_meshes(()))
    rotation = batch.motion.rotation
    position = batch.motion.position_w.copy()
    if world is not batch.world:
        position[:, :2] -= batch.motion.position_w[:, :2].mean(axis=0)
        position[:, 2] = world.terrain.height(position[:, :2]) + 0.125
    nobody = np.zeros((conf.scenes, 0, 4))
    eyes = camera.origin(position, rotation)
    settings = camera.conf

    def theirs() -> None:
        for eye, turn in zip(eyes, rotation, strict=True):
            reference.look(eye, turn[:, 0], settings.width, settings.height, settings.fov_rad)

    return _compared(conf, partial(camera.frames, position, rotation, nobody), theirs)


def _compared(conf: BenchmarkConf, ours: Any, theirs: Any) -> dict[str, float]:
    taken: dict[str, list[float]] = {"ours": [], "theirs": []}
    for action in (ours, theirs):
        seconds(action, 2)
    for _ in range(conf.rounds):
        taken["ours"].append(seconds(ours, 5) / 5)
        taken["theirs"].append(seconds(theirs, 2) / 2)
    return {
        "ours": float(np.median(taken["ours"])) / conf.scenes * 1e6,
        "speedup": median_ratio(taken["theirs"], taken["ours"]),
    }


def _hills(size: int) -> Array:
    x = np.arange(size) * _GRID_SPACING_M
    rolling = np.sin(x[:, None] / 3.1) * np.cos(x / 4.3) + 0.3 * np.sin(x[:, None] / 0.9 + x / 1.3)
    return np.asarray(rolling + 0.02 * np.random.default_rng(0).standard_normal((size, size)))
