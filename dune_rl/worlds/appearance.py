"""A world as a camera sees it."""

from functools import lru_cache

import numpy as np

from dune_rl.rendering.baked import Baked
from dune_rl.rendering.light import Light, LightConf, linear
from dune_rl.rendering.scenery import Scenery, Segment, Shape, joined
from dune_rl.worlds.ground import ground_texture
from dune_rl.worlds.world import Prop, World


def scenery(world: World) -> Scenery:
    """Ground and props, those included that only can be seen (water)."""
    ground = ground_texture(world.terrain, world.ground, world.texture_seed)
    return Scenery(world.terrain, ground, joined([_shape(prop) for prop in world.props]))


@lru_cache(maxsize=4)
def baked(world: World, light: LightConf) -> Baked:
    """The world in that light; equal worlds and lights share one."""
    return Baked(scenery(world), Light.of(light))


def _shape(prop: Prop) -> Shape:
    count = len(prop.faces)
    albedo = np.broadcast_to(linear(np.array(prop.colour)), (count, 3))
    standing = Segment.DECK if prop.drivable else Segment.OBSTACLE
    segment = standing if prop.solid else Segment.WATER
    return Shape(prop.vertices, prop.faces, albedo, np.full(count, segment, np.uint8))
