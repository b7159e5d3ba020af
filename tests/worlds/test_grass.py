"""Tall grass as rays meet it, and where it grows."""

import numpy as np
import pytest
from grass_samples import BEAM_EXTINCTION, EVERYWHERE, EXTINCTION, FULL, PLAIN, SMALL, TALL_M
from simulations import goals_w, motion_of_group, started_simulation

from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.foliage import Foliage
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.grass import Grass, grow_grass
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection


def rays(origins, directions):
    directions = np.atleast_2d(np.asarray(directions, float))
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.atleast_2d(np.asarray(origins)).astype(np.float32), directions.astype(np.float32)


def far(count: int, range_m: float = 30.0) -> np.ndarray:
    return np.full(count, range_m, np.float32)


@pytest.mark.parametrize("depth", [0.05, 1.0, 4.0])
def test_a_beam_ends_where_its_path_has_the_depth_that_is_asked_for(depth):
    origins, directions = rays([0.0, 0.0, 0.3], [[1, 0, 0], [0.6, -0.8, 0.0]])
    met = EVERYWHERE.beam_ranges(origins, directions, far(2), far(2, depth))
    np.testing.assert_allclose(met, depth / BEAM_EXTINCTION, rtol=1e-5)


def test_what_is_solid_ends_the_path():
    origins, directions = rays([0.0, 0.0, 0.3], [1, 0, 0])
    depth = far(1, 1.0 * BEAM_EXTINCTION)
    assert np.isinf(EVERYWHERE.beam_ranges(origins, directions, far(1, 0.99), depth))
    assert EVERYWHERE.beam_ranges(origins, directions, far(1, 1.01), depth) == pytest.approx(1.0)


@pytest.mark.parametrize("down", [0.2, 1.0])
def test_from_above_the_path_begins_at_the_tips(down):
    origins, directions = rays([0.0, 0.0, 2.0], [1.0, 0.0, -down])
    met = EVERYWHERE.beam_ranges(origins, directions, far(1), far(1, 1.0))
    assert met[0] == pytest.approx((2.0 - TALL_M) / -directions[0, 2] + 1.0 / BEAM_EXTINCTION, abs=0.04)


def test_rays_over_the_tips_pass():
    origins, directions = rays([0.0, 0.0, TALL_M + 0.01], [[1, 0, 0], [1, 0, 0.3], [0, 0, 1]])
    assert (EVERYWHERE.transmission(origins, directions, far(3)).passed == 1.0).all()
    assert np.isinf(EVERYWHERE.beam_ranges(origins, directions, far(3), far(3, 1e-3))).all()


def hilly_patches() -> tuple[HeightField, np.ndarray]:
    rng = np.random.default_rng(3)
    terrain = HeightField(rng.uniform(0.0, 0.8, (21, 21)), 1.0, (-10.0, -10.0))
    density = np.clip(rng.normal(-0.2, 0.5, (40, 40)), 0.0, 1.0).astype(np.float32)
    return terrain, density


def slow_depths(terrain, density, origins, directions, ranges) -> np.ndarray:
    """Optical depth per unit of extinction, summed over 4,000 points of each ray."""
    share = (np.arange(4000) + 0.5) / 4000
    points = origins + directions[:, None] * (ranges[:, None] * share)[..., None]
    rows, columns = density.shape
    xmin, xmax, ymin, ymax = terrain.extent
    at = np.stack(
        [(points[..., 1] - ymin) / (ymax - ymin) * rows, (points[..., 0] - xmin) / (xmax - xmin) * columns]
    )
    at = np.clip(at - 0.5, 0.0, np.array([rows - 1, columns - 1])[:, None, None])
    low = np.minimum(at.astype(int), [[[rows - 2]], [[columns - 2]]])
    v, u = at - low
    row, column = low
    found = (density[row, column] * (1 - u) + density[row, column + 1] * u) * (1 - v)
    found += (density[row + 1, column] * (1 - u) + density[row + 1, column + 1] * u) * v
    inside = points[..., 2] < terrain.height(points[..., :2]) + TALL_M
    return (found * inside).mean(axis=1) * ranges


def test_leaping_over_what_is_bare_misses_no_patch():
    terrain, density = hilly_patches()
    solid = RayScene(*terrain.mesh())
    rng = np.random.default_rng(4)
    yaw, up = rng.uniform(-np.pi, np.pi, 400), rng.uniform(-0.4, 0.2, 400)
    origins, directions = rays([0.3, -0.2, 1.2], np.stack([np.cos(yaw), np.sin(yaw), up], axis=1))
    ranges = far(400, 12.0)
    solid.shorten_ranges(origins, directions, ranges)
    expected = slow_depths(terrain, density, origins, directions, ranges)
    foliage = Foliage(terrain, density, TALL_M, 1.0, 1.0)
    for depth in (0.2, 0.6):
        met = foliage.beam_ranges(origins, directions, ranges, far(400, depth))
        reached = np.isfinite(met)
        # What lies before the beam's end is the depth asked for, and all there is where there is none.
        np.testing.assert_allclose(
            slow_depths(terrain, density, origins, directions, met.clip(max=99.0))[reached], depth, atol=0.08
        )
        assert (expected[~reached] < depth + 0.08).all()
        assert (expected[reached] > depth - 0.08).all()
        assert 40 < reached.sum() < 360
    passed = foliage.transmission(origins, directions, ranges).passed
    assert np.abs(-np.log(passed) - expected)[passed > 0.02].mean() < 0.03


@pytest.mark.parametrize("tufts", [False, True])
def test_a_veil_lets_light_pass_by_its_path(tufts):
    origins, directions = rays(
        [0.2, 0.1, 0.2], np.stack([np.ones(64), np.linspace(-1, 1, 64), np.zeros(64)], 1)
    )
    veil = EVERYWHERE.transmission(origins, directions, far(64, 0.4), tufts=tufts)
    # Single tufts hide more or less; their mean is that of the whole.
    assert -np.log(veil.passed).mean() == pytest.approx(0.4 * EXTINCTION, rel=0.15 if tufts else 1e-4)
    assert np.ptp(veil.passed) > 0.05 if tufts else np.ptp(veil.passed) < 1e-5
    assert ((veil.distance > 0.0) & (veil.distance < 0.4)).all()
    seen = np.isfinite(veil.range)
    assert ((veil.passed <= 0.5) == seen).all()


def test_a_ray_from_nowhere_meets_nothing():
    origins = np.full((1, 3), np.nan, np.float32)
    veil = EVERYWHERE.transmission(origins, np.eye(3, dtype=np.float32), far(3))
    assert (veil.passed == 1.0).all()


@pytest.mark.parametrize("cover", [0.05, 0.3, 0.8])
def test_it_covers_the_share_that_is_asked_for(cover):
    grass = grow_grass(PLAIN, (), cover, 0.4, seed=2)
    assert (grass.density > 0.0).mean() == pytest.approx(cover, abs=1e-3)
    assert grass.density.max() <= 1.0
    again, other = (grow_grass(PLAIN, (), cover, 0.4, seed=seed) for seed in (2, 3))
    np.testing.assert_array_equal(again.density, grass.density)
    assert (other.density != grass.density).any()


def test_none_is_none():
    assert grow_grass(PLAIN, (), 0.0, 0.4, seed=2) is None
    assert build_inspection(InspectionConf()).grass is None


def test_it_grows_on_nothing_that_stands_or_lies_there():
    world = build_inspection(InspectionConf(seed=1, grass_cover=1.0))
    grass = world.grass
    assert 0.6 < (grass.density > 0.0).mean() < 0.95
    kinds = set()
    rng = np.random.default_rng(0)
    for prop in world.props:
        corners = prop.vertices[prop.faces]
        weights = rng.dirichlet([1.0, 1.0, 1.0], (8, len(corners)))
        points = np.einsum("kfc,fci->kfi", weights, corners).reshape(-1, 3)
        points = points[points[:, 2] > world.terrain.height(points[:, :2])]
        assert (grass.foliage.density_at(points) == 0.0).all(), prop.name
        kinds.add((prop.solid, prop.drivable))
    assert kinds == {(True, False), (True, True), (False, False)}


def test_it_is_no_obstacle():
    bare, grown = (build_flat(FlatConf(size_m=20.0, grass_cover=cover)) for cover in (0.0, 0.9))
    assert grown.clearance([[0.0, 0.0]]) == np.inf
    np.testing.assert_array_equal(grown.solid_mesh().vertices, bare.solid_mesh().vertices)
    without, within = (started_simulation({**SMALL, "grass_cover": cover}, 2, seed=4) for cover in (0.0, 0.9))
    np.testing.assert_array_equal(motion_of_group(without).position_w, motion_of_group(within).position_w)
    np.testing.assert_array_equal(goals_w(without), goals_w(within))
    for simulation in (without, within):
        simulation.close()


def test_impossible_grass_is_refused():
    for density, height, message in (
        (FULL * 1.5, 0.6, "density must be between 0 and 1"),
        (FULL * np.nan, 0.6, "density must be between 0 and 1"),
        (FULL[0], 0.6, "density must be a grid"),
        (FULL, 0.0, "height_m must be positive, not 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            Grass(PLAIN, density, height)
    with pytest.raises(ConfigError) as caught:
        compose(Conf, ["+world=inspection", "world.grass_cover=1.5", "world.grass_height_m=0"])
    assert str(caught.value).splitlines() == [
        "world.grass_cover must be at most 1.0 (got 1.5)",
        "world.grass_height_m must be above 0.0 (got 0)",
    ]
