"""The context that sensors are built from: the worlds of the scenes, and the body that carries sensors."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.geometry.shared_per_scene import BatchedHeightFields, BatchedRayScenes
from dune_rl.rendering.foliage import BatchedFoliage, Foliage
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.rendering.scenery import BatchedBeamSurfaces
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.sensors.camera import Camera, CameraConf, Cameras
from dune_rl.sensors.context import SensorContext
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.worlds.appearance import bake_in_weather, beam_surface, with_own_sun
from dune_rl.worlds.batched_worlds import BatchedWorlds, WorldAppearance
from dune_rl.worlds.world import Rectangle, World

# Over the highest and under the lowest solid point, where a body can still be.
_MARGIN_M = 1.0


def sensor_context(
    worlds: BatchedWorlds,
    carrier: SensorCarrier,
    meshes: Sequence[MovingMesh],
    *,
    num_rows: int,
    step_s: float,
    action_size: int = 0,
    extent: Rectangle | None = None,
    worlds_differ: bool = False,
) -> SensorContext:
    """What the sensors of a group with `num_rows` agents see of `worlds`.

    `meshes` are the moving bodies in the order of the columns of the group's `neighbours`. Where
    `worlds_differ` from episode to episode, bounds follow from the size of the first world alone, so that
    observation spaces never change.
    """
    # All worlds have the extent of the first.
    world, weather = worlds.appearances[0].world, worlds.appearances[0].weather
    extent = world.extent if extent is None else extent
    return SensorContext(
        num_rows=num_rows,
        step_s=step_s,
        action_size=action_size,
        carrier=carrier,
        solid=BatchedRayScenes(worlds.worlds.map(_rays)),
        surfaces=BatchedBeamSurfaces(worlds.worlds.map(beam_surface)),
        meshes=meshes,
        terrain=BatchedHeightFields(worlds.worlds.map(_terrain)),
        extent=extent,
        heights=_height_limits(extent) if worlds_differ else _heights(world),
        make_cameras=partial(_cameras, worlds, meshes),
        air=_beam_air(worlds, weather, worlds_differ),
    )


def _cameras(worlds: BatchedWorlds, meshes: Sequence[MovingMesh], conf: CameraConf) -> Cameras:
    def camera(look: WorldAppearance) -> Camera:
        return Camera(conf, bake_in_weather(look.world, look.weather), meshes, look.media)

    return Cameras(worlds.appearances.map(camera))


def _beam_air(worlds: BatchedWorlds, weather: WeatherConf, worlds_differ: bool) -> BeamMedia:
    grassy = worlds_differ or any(world.grass is not None for world, _ in worlds.worlds.groups)
    return BeamMedia(
        Haze.from_weather(with_own_sun(worlds.worlds[0], weather)),
        BatchedFoliage(worlds.worlds.map(_foliage)) if grassy else None,
    )


def _heights(world: World) -> tuple[float, float]:
    """Heights [m] between which a body can be in `world`."""
    heights = world.solid_mesh().vertices[:, 2]
    return float(heights.min()) - _MARGIN_M, float(heights.max()) + _MARGIN_M


def _height_limits(extent: Rectangle) -> tuple[float, float]:
    """Heights [m] between which a body can be in any world of this extent."""
    xmin, xmax, ymin, ymax = extent
    reach = float(np.hypot(xmax - xmin, ymax - ymin)) / 2
    return -reach, reach


def _rays(world: World) -> RayScene:
    return world.rays


def _terrain(world: World) -> HeightField:
    return world.terrain


def _foliage(world: World) -> Foliage | None:
    return None if world.grass is None else world.grass.foliage
