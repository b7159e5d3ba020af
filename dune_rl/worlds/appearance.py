"""A world as a camera sees it."""

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.baked import Baked
from dune_rl.rendering.light import Light, LightConf, linear
from dune_rl.rendering.scenery import GroundTexture, Scenery, Shape, joined
from dune_rl.rendering.weather import Haze, WeatherConf, light_in
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground import ground_texture
from dune_rl.worlds.world import Prop, World

_LIGHTS_KEPT = 4


def scenery(world: World) -> Scenery:
    """Ground and props, those included that only can be seen (water)."""
    ground = ground_texture(world.terrain, world.ground, world.texture_seed)
    if world.grass is not None:
        ground = GroundTexture(_in_shade(ground.albedo, world.grass))
    return Scenery(world.terrain, ground, joined([_shape(prop) for prop in world.props]))


def baked(world: World, light: LightConf) -> Baked:
    """The world in that light and clear air; equal lights share one."""
    return _lit(world, light, lambda: Light.of(light))


def in_weather(world: World, weather: WeatherConf) -> Baked:
    """The world in the light of a weather; what its haze does on the way to an eye is not in it."""
    if Haze.of(weather) is None:
        return baked(world, weather.sunlight)
    return _lit(world, weather, lambda: light_in(weather))


def _lit(world: World, key: Hashable, light: Callable[[], Light]) -> Baked:
    """The world in a light, of which the latest few are kept with it."""
    looks = world.kept("baked", OrderedDict[Hashable, Baked])
    if key in looks:
        looks.move_to_end(key)
        return looks[key]
    # What does not hang on the light takes most of the time.
    known = next(iter(looks.values()), None)
    looks[key] = Baked(scenery(world), light()) if known is None else known.relit(light())
    if len(looks) > _LIGHTS_KEPT:
        looks.popitem(last=False)
    return looks[key]


def _in_shade(albedo: NDArray[np.float32], grass: Grass) -> NDArray[np.float32]:
    """Albedo (rows, columns, 3) of the ground, less by the light that the grass on it keeps."""
    rows, columns = albedo.shape[:2]
    xmin, xmax, ymin, ymax = grass.terrain.extent
    x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
    share = grass.foliage.shade(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    return albedo * share.reshape(rows, columns, 1)


def _shape(prop: Prop) -> Shape:
    count = len(prop.faces)
    albedo = np.broadcast_to(linear(np.array(prop.colour)), (count, 3))
    return Shape(prop.vertices, prop.faces, albedo, np.full(count, prop.shown_as, np.uint8))
