"""Grass of the live page: tufts stand where it grows, in sun or shade."""

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.light import Light, LightConf
from dune_rl.rendering.scenery import ColouredMesh, Scenery, Segment
from dune_rl.rendering.web.grass import place_tufts, tuft_surface

LIGHT = Light.from_conf(LightConf(sun_elevation_deg=90.0))
# A roof over the quarter of large x and y, at a height of 3 m.
ROOF = np.array([[0, 0, 3], [8, 0, 3], [8, 8, 3], [0, 8, 3]], float)


def slope_with_a_roof() -> BakedScenery:
    x = np.linspace(-8.0, 8.0, 17)
    terrain = HeightField(np.tile(0.1 * x, (17, 1)), 1.0, (-8.0, -8.0))
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    roof = ColouredMesh(ROOF, faces, np.full((2, 3), 0.3, np.float32), np.full(2, Segment.DECK, np.uint8))
    return BakedScenery(Scenery(terrain, np.full((16, 16, 3), 0.2, np.float32), roof), LIGHT)


def grass_of_density(baked: BakedScenery, density: np.ndarray) -> Foliage:
    return Foliage(baked.terrain, density.astype(np.float32), 0.6, 2.5, 2.0)


def test_tufts_stand_on_the_ground_where_grass_grows() -> None:
    baked = slope_with_a_roof()
    # From the lowest x on: nothing, half, half, and nothing.
    density = np.tile(np.repeat([0.0, 0.2, 0.8, 0.0], 8), (32, 1))
    grass = grass_of_density(baked, density)
    tufts = place_tufts(grass, baked)
    assert (grass.density_at(tufts.positions) > 0.0).all()
    np.testing.assert_allclose(tufts.positions[:, 2], baked.terrain.height(tufts.positions[:, :2]), atol=1e-5)
    x, y = tufts.positions[:, 0], tufts.positions[:, 1]
    thin, thick = ((x > -3.5) & (x < -0.5)).sum(), ((x > 0.5) & (x < 3.5)).sum()
    assert 1.5 * thin < thick
    np.testing.assert_array_equal(tufts.in_sun, ~((x > 0.0) & (y > 0.0)))
    np.testing.assert_array_equal(tufts.positions, place_tufts(grass, baked).positions)


def test_a_tuft_is_as_tall_as_the_grass_and_darker_at_its_root_and_in_the_shade() -> None:
    sunny, shaded = (tuft_surface(LIGHT, 0.8, in_sun=in_sun) for in_sun in (True, False))
    assert np.isclose(sunny.corners[..., 2].max(), 0.8)
    is_tip = sunny.corners[..., 2] > 0.0
    assert sunny.colours[is_tip].mean() > 1.5 * sunny.colours[~is_tip].mean()
    assert (shaded.colours < sunny.colours).all()
