"""The scenery of a world, lit for cameras."""

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np
import scipy

from dune_rl.geometry.arrays import Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.rendering.baked_scenery import LAST_CACHED, BakedScenery
from dune_rl.rendering.light import Light, LightConf, srgb_to_linear
from dune_rl.rendering.scenery import BeamSurface, ColouredMesh, Scenery, Segment, join_meshes
from dune_rl.rendering.weather import Haze, WeatherConf, weather_light
from dune_rl.worlds.cache.folder import DiskCache
from dune_rl.worlds.ground_texture import ground_texture, ground_texture_from_picture
from dune_rl.worlds.world import Prop, World

_LIGHTS_CACHED = 4
# Default lights: today's, and the former one of 2.2 and 0.75 rad, which saved runs have.
_UNSET_LIGHTS = (LightConf(), LightConf(sun_bearing_deg=126.050714929, sun_elevation_deg=42.971834635))


def build_scenery(world: World) -> Scenery:
    """Ground and all props, including those that are only visible (water)."""
    ground = world.disk_cached("albedo of the ground", lambda: _ground_albedo(world))
    return Scenery(world.terrain, ground, join_meshes([_coloured_mesh(prop) for prop in world.props]))


def bake_world(world: World, light: LightConf) -> BakedScenery:
    """The world in that light and clear air; cached with the world."""
    return _bake(world, light, lambda: Light.from_conf(light))


def bake_in_weather(world: World, weather: WeatherConf) -> BakedScenery:
    """The world in the light of a weather, without the haze between surfaces and the camera."""
    weather = with_own_sun(world, weather)
    if Haze.from_weather(weather) is None:
        return bake_world(world, weather.sunlight)
    return _bake(world, weather, lambda: weather_light(weather))


def _bake(world: World, key: Hashable, light: Callable[[], Light]) -> BakedScenery:
    """The world in a light; the last few lights are cached with the world."""
    cache = world.memoize("baked", OrderedDict[Hashable, BakedScenery])
    if key in cache:
        cache.move_to_end(key)
        return cache[key]
    # Most of the time goes into what does not depend on the light.
    if other := next(iter(cache.values()), None):
        cache[key] = other.relight(light())
    else:
        cache[key] = BakedScenery(build_scenery(world), light(), world.disk_cached)
    if len(cache) > _LIGHTS_CACHED:
        cache.popitem(last=False)
    return cache[key]


def precompute_appearance(world: World) -> None:
    """Compute what every picture of a world needs, so that its disk cache holds it."""
    BakedScenery(build_scenery(world), Light.from_conf(LightConf()), world.disk_cached)


def is_appearance_cached(disk_cache: DiskCache) -> bool:
    """Whether `precompute_appearance` has filled that disk cache."""
    return disk_cache.contains(LAST_CACHED)


def _ground_albedo(world: World) -> Floats:
    look = world.terrain, world.ground, world.texture_seed
    if world.picture is None:
        albedo = ground_texture(*look, world.surfaces)
    else:
        albedo = ground_texture_from_picture(*look, world.picture)
    if world.grass is None:
        return albedo
    # Grass absorbs light on its way to the ground.
    rows, columns = albedo.shape[:2]
    centres = cell_centres(world.terrain.extent, rows, columns).reshape(-1, 2)
    return albedo * world.grass.foliage.shade(centres).reshape(rows, columns, 1)


def with_own_sun(world: World, weather: WeatherConf) -> WeatherConf:
    """`weather`, with the world's own sun if it has one and the weather does not set one."""
    if world.light is None or weather.time_of_day_h is not None or weather.light not in _UNSET_LIGHTS:
        return weather
    return weather.model_copy(update={"light": world.light})


def _coloured_mesh(prop: Prop) -> ColouredMesh:
    count = len(prop.faces)
    colours = np.array(prop.colour) if prop.face_colours is None else prop.face_colours
    albedo = np.broadcast_to(srgb_to_linear(colours), (count, 3))
    return ColouredMesh(*prop.mesh, albedo, np.full(count, prop.segment_class, np.uint8), prop.texture)


def beam_surface(world: World) -> BeamSurface:
    """Segments and luminances of the faces of `world.solid_mesh()`, in their order; cached with the world."""
    return world.memoize("beam surface", lambda: _build_beam_surface(world))


def _build_beam_surface(world: World) -> BeamSurface:
    scenery = build_scenery(world)
    albedo = _face_albedo(world.terrain, scenery.ground)
    solid = np.repeat([prop.solid for prop in world.props], [len(prop.faces) for prop in world.props])
    if len(solid) != len(scenery.props.faces):
        raise ValueError(
            f"the props of {world.name} have {len(solid)} faces, but its scenery has "
            f"{len(scenery.props.faces)}: they must be the same, in the same order"
        )
    ground = np.full(len(albedo), Segment.GROUND, np.uint8)
    solid = solid.astype(bool)
    return BeamSurface.from_faces(
        np.concatenate([ground, scenery.props.segments[solid]]),
        np.concatenate([albedo, scenery.props.albedo[solid]]),
    )


def _face_albedo(terrain: HeightField, texture: Floats) -> Floats:
    """Linear RGB (F, 3) of the terrain's faces: the texture's mean over a square of a cell's size."""
    rows, columns = texture.shape[:2]
    xmin, xmax, ymin, ymax = terrain.extent
    per_m = np.array([columns / (xmax - xmin), rows / (ymax - ymin)])
    width, height = np.maximum(1, np.round(terrain.spacing_m * per_m).astype(int))
    mean = scipy.ndimage.uniform_filter(texture, (height, width, 1), mode="nearest")
    vertices, faces = terrain.mesh()
    centres = vertices[faces, :2].mean(axis=1)
    column, row = ((centres - [xmin, ymin]) * per_m).astype(np.intp).T
    return mean[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
