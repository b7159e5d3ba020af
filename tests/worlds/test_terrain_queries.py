"""What a world tells of its ground and its obstacles, against sums done point by point."""

import numpy as np
import pytest

from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.rubicon import RubiconConf, build_rubicon
from dune_rl.worlds.world import Prop, World


@pytest.fixture(scope="module", params=["inspection", "rubicon"])
def world(request: pytest.FixtureRequest) -> World:
    if request.param == "inspection":
        return build_inspection(InspectionConf(seed=1))
    return build_rubicon(RubiconConf(seed=1))


def places(world: World, count: int, seed: int = 0) -> np.ndarray:
    xmin, xmax, ymin, ymax = world.extent
    return np.random.default_rng(seed).uniform([xmin + 2, ymin + 2], [xmax - 2, ymax - 2], (count, 2))


def fitted(world: World, xy: np.ndarray, radius: float) -> float:
    axis = np.linspace(-radius, radius, 81)
    x, y = (values.reshape(-1) for values in np.meshgrid(axis, axis))
    inside = np.hypot(x, y) <= radius
    x, y = x[inside], y[inside]
    heights = world.terrain.height(xy + np.stack([x, y], axis=-1))
    left = np.linalg.lstsq(np.stack([np.ones_like(x), x, y], axis=-1), heights, rcond=None)[1]
    return float(np.sqrt(left[0] / len(x)))


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.5, 1.5])
def test_roughness_is_what_a_plane_leaves(world: World, radius: float) -> None:
    points = places(world, 60)
    truth = np.array([fitted(world, xy, radius) for xy in points])
    told = world.roughness(points, radius)
    assert np.ptp(truth) > 0.01
    assert np.abs(told - truth).max() < 0.1 * truth.max()
    np.testing.assert_allclose(told.mean(), truth.mean(), rtol=0.05)


def test_roughness_of_a_slope_is_none_and_of_a_wave_its_height() -> None:
    x = np.arange(0.0, 40.0, 0.05)
    region = (5.0, 35.0, 1.0, 2.0)
    slope = World("slope", HeightField(np.tile(0.4 * x + 500.0, (80, 1)), 0.05, (0.0, 0.0)), region=region)
    points = np.array([[20.0, 2.0], [8.0, 1.5]])
    assert slope.roughness(points).max() < 1e-5
    # Many waves in the disc: the plane explains nothing of them.
    wave = World(
        "wave", HeightField(np.tile(0.1 * np.sin(x * 8.0), (800, 1)), 0.05, (0.0, 0.0)), region=region
    )
    np.testing.assert_allclose(wave.roughness([[20.0, 20.0]], 4.0), 0.1 / np.sqrt(2.0), rtol=0.02)


def test_nearest_obstacles_are_where_they_are_said_to_be(world: World) -> None:
    points = places(world, 400)
    distance, nearest = world.nearest_obstacle(points)
    np.testing.assert_array_equal(distance, world.clearance(points))
    away = np.hypot(*(nearest - points).T)
    assert np.abs(away - distance).max() < 2 * world.clearance_field.cell_m
    assert world.clearance(nearest).max() < 2 * world.clearance_field.cell_m
    # None is nearer, of all grid points that stand in one.
    field = world.clearance_field
    assert field.distance is not None
    row, column = np.nonzero(field.distance.reshape(field.rows, field.columns) == 0.0)
    blocked = np.array(world.extent)[[0, 2]] + field.cell_m * np.stack([column, row], axis=-1)
    outside = distance > 0.0
    brute = np.array([np.hypot(*(blocked - xy).T).min() for xy in points[outside]])
    assert np.abs(away[outside] - brute).max() < field.cell_m
    assert (away[~outside] == 0.0).all()


def test_a_box_is_nearest_at_its_side() -> None:
    corners = np.array([[x, y, z] for z in (-1.0, 1.0) for y in (-0.5, 0.5) for x in (2.0, 3.0)])
    faces = [
        *([0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]),
        *([2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]),
    ]
    flat = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
    box = Prop("box", "box", corners, np.array(faces, np.int32))
    distance, nearest = World("box", flat, [box], region=(-5.0, 1.0, -5.0, 5.0)).nearest_obstacle(
        [[0.0, 0.0], [2.5, 4.0], [2.5, 0.0]]
    )
    np.testing.assert_allclose(distance, [2.0, 3.5, 0.0], atol=0.1)
    np.testing.assert_allclose(nearest, [[2.0, 0.0], [2.5, 0.5], [2.5, 0.0]], atol=0.1)


@pytest.mark.slow
def test_queries_take_any_shape_and_answer_where_there_is_nothing() -> None:
    flat = build_flat(FlatConf())
    points = np.zeros((3, 4, 2))
    distance, nearest = flat.nearest_obstacle(points)
    assert distance.shape == (3, 4) and np.isinf(distance).all()
    assert nearest.shape == (3, 4, 2) and np.isnan(nearest).all()
    assert (flat.roughness(points) == 0.0).all() and flat.roughness(points).shape == (3, 4)
    assert flat.roughness([1e6, -1e6]).shape == ()


def test_a_radius_too_small_for_the_world_is_refused() -> None:
    wide = HeightField(np.zeros((2, 2)), 10_000.0, (0.0, 0.0))
    with pytest.raises(ValueError, match=r"use 15 or more"):
        World("wide", wide, region=(1.0, 2.0, 1.0, 2.0)).roughness([[0.0, 0.0]], 1.0)
