"""A world as a camera sees it."""

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.baked_scenery import LAST_KEPT, BakedScenery
from dune_rl.rendering.light import Light, LightConf, srgb_to_linear
from dune_rl.rendering.scenery import GroundTexture, Scenery, ColouredMesh, join_meshes
from dune_rl.rendering.weather import Haze, WeatherConf, weather_light
from dune_rl.worlds.cache_folder import DiskCache
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground import ground_texture, apply_ground_picture
from dune_rl.worlds.world import Prop, World

_LIGHTS_KEPT = 4


def build_scenery(world: World) -> Scenery:
    """Ground and props, those included that only can be seen (water)."""
    ground = GroundTexture(world.disk_cached("albedo of the ground", lambda: _ground_albedo(world)))
    return Scenery(world.terrain, ground, join_meshes([_shape(prop) for prop in world.props]))


def bake_world(world: World, light: LightConf) -> BakedScenery:
    """The world in that light and clear air; equal lights share one."""
    return _lit(world, light, lambda: Light.of(light))


def bake_in_weather(world: World, weather: WeatherConf) -> BakedScenery:
    """The world in the light of a weather; what its haze does on the way to an eye is not in it."""
    weather = with_own_sun(world, weather)
    if Haze.of(weather) is None:
        return bake_world(world, weather.sunlight)
    return _lit(world, weather, lambda: weather_light(weather))


def _lit(world: World, key: Hashable, light: Callable[[], Light]) -> BakedScenery:
    """The world in a light, of which the latest few are kept with it."""
    looks = world.memoize("baked", OrderedDict[Hashable, BakedScenery])
    if key in looks:
        looks.move_to_end(key)
        return looks[key]
    # What does not hang on the light takes most of the time.
    known = next(iter(looks.values()), None)
    looks[key] = BakedScenery(build_scenery(world), light(), world.disk_cached) if known is None else known.relight(light())
    if len(looks) > _LIGHTS_KEPT:
        looks.popitem(last=False)
    return looks[key]


def precompute_appearance(world: World) -> None:
    """Have what every picture of a world needs worked out, and kept where it has a shelf."""
    BakedScenery(build_scenery(world), Light.of(LightConf()), world.disk_cached)


def is_appearance_cached(shelf: DiskCache) -> bool:
    """Whether `precompute_appearance` has been done for the world of that shelf."""
    return shelf.holds(LAST_KEPT)


def _ground_albedo(world: World) -> NDArray[np.float32]:
    if world.picture is None:
        ground = ground_texture(world.terrain, world.ground, world.texture_seed, world.surfaces)
    else:
        ground = apply_ground_picture(world.terrain, world.ground, world.texture_seed, world.picture)
    return ground.albedo if world.grass is None else _in_shade(ground.albedo, world.grass)


def with_own_sun(world: World, weather: WeatherConf) -> WeatherConf:
    """`weather`, with the world's own sun where it has one and the weather does not say where its is."""
    if world.light is None or weather.time_of_day_h is not None or weather.light != LightConf():
        return weather
    return weather.model_copy(update={"light": world.light})


def _in_shade(albedo: NDArray[np.float32], grass: Grass) -> NDArray[np.float32]:
    """Albedo (rows, columns, 3) of the ground, less by the light that the grass on it keeps."""
    rows, columns = albedo.shape[:2]
    xmin, xmax, ymin, ymax = grass.terrain.extent
    x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
    share = grass.foliage.shade(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    return albedo * share.reshape(rows, columns, 1)


def _shape(prop: Prop) -> ColouredMesh:
    count = len(prop.faces)
    colours = np.array(prop.colour) if prop.face_colours is None else prop.face_colours
    albedo = np.broadcast_to(srgb_to_linear(colours), (count, 3))
    return ColouredMesh(prop.vertices, prop.faces, albedo, np.full(count, prop.segment_class, np.uint8), prop.texture)
