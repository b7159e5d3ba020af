"""Cost of LiDAR and camera, compared with the physics engine's own rays and pictures."""

from collections.abc import Callable
from functools import partial

import numpy as np

from dune_rl.commands.benchmark.measuring import median_ratio, start_simulation, time_in_turns
from dune_rl.config.commands import BenchmarkConf
from dune_rl.core.errors import ConfigError
from dune_rl.env.pictures import Pictures
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import POSE_COLUMNS
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.bullet.reference import BulletReference
from dune_rl.physics.shapes import StaticBody
from dune_rl.rendering.light import LightConf
from dune_rl.sensors.camera import Camera, CameraConf
from dune_rl.sensors.lidar import Lidar, beam_angles
from dune_rl.worlds.appearance import bake_world
from dune_rl.worlds.world import World

_GRID, _GRID_SPACING_M = 256, 0.25
_CALLS = {"ours": 5, "theirs": 2}


def measure_sensors(conf: BenchmarkConf) -> dict[str, float]:
    """Times per scene [µs] of LiDAR and camera, speed-ups over PyBullet's, and the time of a picture [s].

    A speed-up above 1 means that ours is faster. Both have equal geometry and equal poses: those of the
    first agent of each scene.
    """
    simulation = start_simulation(conf)
    world = simulation.worlds.worlds[0]
    vertices, faces = world.terrain.mesh()
    statics = [StaticBody("ground", vertices, faces, 1.0, ground=True)]
    statics += [StaticBody(prop.name, prop.vertices, prop.faces, 1.0, ground=False) for prop in world.props]
    reference = BulletReference(statics)
    lidar = _compare_lidar(conf, world, simulation, reference)
    camera = _compare_camera(conf, world, simulation, reference)
    reference.close()
    grid = HeightField(_hills(_GRID), _GRID_SPACING_M, (-_GRID_SPACING_M * (_GRID - 1) / 2,) * 2)
    field = World("hills", grid, region=(-5.0, 5.0, -5.0, 5.0))
    heights = BulletReference(heights=grid.heights, spacing_m=_GRID_SPACING_M)
    hills = _compare_camera(conf, field, simulation, heights)
    heights.close()
    large = partial(Pictures(simulation).from_behind, 0, 1280, 720)
    pictures = time_in_turns({"large": large}, min(5, conf.rounds), warm_up=1)["large"]
    simulation.close()
    return {
        "lidar_us": lidar["ours"],
        "lidar_speedup": lidar["speedup"],
        "camera_us": camera["ours"],
        "camera_speedup": camera["speedup"],
        "camera_speedup_heightfield": hills["speedup"],
        "picture_1280x720_s": float(np.median(pictures)),
    }


def _first_agents(simulation: VectorSimulation) -> tuple[Array, Array]:
    """Positions (M, 3) [m] and rotations (M, 3, 3) of the first agent of each scene."""
    group = simulation.group()
    motion = simulation.state.groups[group.name].motion
    return motion.position_w[:: group.count], motion.rotation[:: group.count]


def _compare_lidar(
    conf: BenchmarkConf, world: World, simulation: VectorSimulation, reference: BulletReference
) -> dict[str, float]:
    suite = simulation.group().suite
    if suite is None:
        raise ConfigError("parts=[sensors] needs a group with sensors")
    # Of one ring, as the reference.
    settings = suite.settings_of("lidar").model_copy(update={"rings_deg": ()})
    solid = world.solid_mesh()
    lidar = Lidar(settings, RayScene(solid.vertices, solid.faces), [])
    no_neighbours = np.zeros((conf.scenes, 0, POSE_COLUMNS))
    position, rotation = _first_agents(simulation)
    angles = beam_angles(settings)
    beams = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    origin = lidar.origin(position, rotation)
    ends = origin[:, None] + settings.range_m * beams @ rotation.transpose(0, 2, 1)
    rays = [([start.tolist()] * len(beams), end.tolist()) for start, end in zip(origin, ends, strict=True)]

    def cast_theirs() -> None:
        for starts, stops in rays:
            reference.cast(starts, stops)

    return _compare(conf, partial(lidar.ranges, position, rotation, no_neighbours), cast_theirs)


def _compare_camera(
    conf: BenchmarkConf, world: World, simulation: VectorSimulation, reference: BulletReference
) -> dict[str, float]:
    camera = Camera(CameraConf(), bake_world(world, LightConf()), [])
    position, rotation = _first_agents(simulation)
    if world is not simulation.worlds.worlds[0]:
        position = position.copy()
        position[:, :2] -= position[:, :2].mean(axis=0)
        position[:, 2] = world.terrain.height(position[:, :2]) + 0.125
    no_neighbours = np.zeros((conf.scenes, 0, POSE_COLUMNS))
    eyes = camera.origin(position, rotation)
    settings = camera.conf

    def render_theirs() -> None:
        for eye, turn in zip(eyes, rotation, strict=True):
            reference.look(eye, turn[:, 0], settings.width, settings.height, settings.fov_deg)

    return _compare(conf, partial(camera.frames, position, rotation, no_neighbours), render_theirs)


def _compare(
    conf: BenchmarkConf, ours: Callable[[], object], theirs: Callable[[], object]
) -> dict[str, float]:
    times = time_in_turns({"ours": ours, "theirs": theirs}, conf.rounds, _CALLS, warm_up=2)
    return {
        "ours": float(np.median(times["ours"])) / conf.scenes * 1e6,
        "speedup": median_ratio(times["theirs"], times["ours"]),
    }


def _hills(size: int) -> Array:
    x = np.arange(size) * _GRID_SPACING_M
    rolling = np.sin(x[:, None] / 3.1) * np.cos(x / 4.3) + 0.3 * np.sin(x[:, None] / 0.9 + x / 1.3)
    return np.asarray(rolling + 0.02 * np.random.default_rng(0).standard_normal((size, size)))
