"""The height field against its own triangles, by other means than its look-up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene


def bumpy(seed: int = 0, rows: int = 9, columns: int = 13) -> HeightField:
    heights = np.random.default_rng(seed).normal(0.0, 0.5, (rows, columns))
    return HeightField(heights, 0.7, (-3.0, 5.0))


def test_extent_follows_columns_and_rows():
    field = bumpy()
    assert field.extent == pytest.approx((-3.0, -3.0 + 12 * 0.7, 5.0, 5.0 + 8 * 0.7))


def test_vertices_are_met_exactly():
    field = bumpy()
    vertices, _ = field.mesh()
    np.testing.assert_allclose(field.height(vertices[:, :2]), vertices[:, 2], atol=1e-12)


def test_height_and_normal_are_those_of_the_mesh():
    # Embree knows nothing of the grid: a ray straight down must meet what the look-up says.
    field = bumpy()
    xmin, xmax, ymin, ymax = field.extent
    rng = np.random.default_rng(1)
    xy = rng.uniform([xmin + 0.01, ymin + 0.01], [xmax - 0.01, ymax - 0.01], (5000, 2))
    origins = np.column_stack([xy, np.full(len(xy), 10.0)])
    hit, normals = RayScene(*field.mesh()).first_hit(origins, np.tile([0.0, 0.0, -1.0], (len(xy), 1)), 50.0)
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    height, normal = field.height_and_normal(xy)
    np.testing.assert_allclose(height, 10.0 - hit, atol=1e-4)
    # A point within rounding of an edge may be given to either triangle.
    same = np.abs(np.abs(normals) - np.abs(normal)).max(axis=-1) < 1e-3
    assert same.mean() > 0.999
    assert (normal[:, 2] > 0).all()


def test_faces_run_counter_clockwise_from_above():
    vertices, faces = bumpy().mesh()
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all()


def test_slope_of_an_inclined_plane():
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    field = HeightField(0.3 * x - 0.4 * y, 1.0, (0.0, 0.0))
    xy = np.random.default_rng(0).uniform(0, 3, (50, 2))
    np.testing.assert_allclose(field.slope(xy), np.arctan(0.5), atol=1e-9)
    np.testing.assert_allclose(field.height(xy), 0.3 * xy[:, 0] - 0.4 * xy[:, 1], atol=1e-12)
    np.testing.assert_allclose(field.normal(xy), np.tile([-0.3, 0.4, 1.0] / np.sqrt(1.25), (50, 1)))


@given(x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_beyond_the_edge_the_edge_answers(x, y):
    field = bumpy()
    xmin, xmax, ymin, ymax = field.extent
    inside = np.array([np.clip(x, xmin, xmax), np.clip(y, ymin, ymax)])
    assert field.height(np.array([x, y])) == pytest.approx(float(field.height(inside)), abs=1e-9)


@pytest.mark.parametrize("shape", [(), (3,), (4, 5), (0,)])
def test_any_shape_of_points(shape):
    field = bumpy()
    xy = np.zeros((*shape, 2))
    height, normal = field.height_and_normal(xy)
    assert np.shape(height) == shape
    assert normal.shape == (*shape, 3)
    assert np.shape(field.slope(xy)) == shape


def test_a_nan_is_answered_not_raised():
    assert np.isfinite(bumpy().height(np.array([np.nan, 6.0])))


@pytest.mark.parametrize(
    ("heights", "spacing", "says"),
    [
        (np.zeros((1, 5)), 1.0, "at least 2 by 2"),
        (np.zeros(5), 1.0, "at least 2 by 2"),
        (np.full((3, 3), np.nan), 1.0, "finite"),
        (np.zeros((3, 3)), 0.0, "spacing_m"),
    ],
)
def test_bad_grids_are_refused(heights, spacing, says):
    with pytest.raises(ValueError, match=says):
        HeightField(heights, spacing, (0.0, 0.0))


def test_the_given_array_is_not_shared():
    heights = np.zeros((3, 3))
    field = HeightField(heights, 1.0, (0.0, 0.0))
    heights[:] = 7.0
    assert float(field.height(np.array([1.2, 1.3]))) == 0.0


def test_height_and_normal_together_are_those_of_each_alone():
    rng = np.random.default_rng(3)
    field = HeightField(rng.normal(size=(12, 17)), 0.3, (-2.0, 1.0))
    points = rng.uniform(-4.0, 8.0, (200, 3, 2))
    points[0, 0] = np.nan
    for xy in (points, points[1, 1], points[:0]):
        height, normal = field.height_and_normal(xy)
        np.testing.assert_array_equal(height, field.height(xy))
        np.testing.assert_array_equal(normal, field.normal(xy))


def test_heights_cannot_be_written():
    field = HeightField(np.zeros((3, 3)), 1.0, (0.0, 0.0))
    with pytest.raises(ValueError, match="read-only"):
        field.heights[1, 1] = 2.0
