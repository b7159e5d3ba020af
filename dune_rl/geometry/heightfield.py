"""Values on regular grids: interpolation, and terrain as heights with two triangles per cell."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.compiled import compile_function

# Origin (2,), inverse of the spacing, and the last column and row (2,) of a grid.
Grid = tuple[Array, float, Array]


def cell_centres(extent: tuple[float, float, float, float], rows: int, columns: int) -> Array:
    """Centres (rows, columns, 2) [m] of cells that divide `extent` (xmin, xmax, ymin, ymax) evenly."""
    xmin, xmax, ymin, ymax = extent
    x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
    return np.stack(np.meshgrid(x, y), axis=-1)


def grid_of(rows: int, columns: int, spacing_m: float, origin: ArrayLike) -> Grid:
    """The grid of `rows` by `columns` points from `origin` (2,) on."""
    return np.array(origin), 1.0 / spacing_m, np.array([columns - 1, rows - 1], np.float64)


def interpolate_grid(grid: Grid, values: NDArray[np.floating], xy: ArrayLike) -> Array:
    """Bilinear values (...) at points (..., 2) between the `values` of a grid, which are row after row.

    A point outside gets the value of the nearest point of the edge, and NaN that of the first corner.
    """
    points = np.ascontiguousarray(xy, np.float64)
    found = np.empty(points.shape[:-1])
    _interpolate_bilinear(points.reshape(-1, 2), *grid, values, found.reshape(-1))
    interpolated: Array = found[()]
    return interpolated


class GridField:
    """Callable: `values` (rows, columns) between the points of a regular grid (`interpolate_grid`)."""

    def __init__(self, values: NDArray[np.floating], origin: ArrayLike, cell_m: float) -> None:
        self._values = np.ascontiguousarray(values).reshape(-1)
        self._grid = grid_of(values.shape[0], values.shape[1], cell_m, origin)

    def __call__(self, xy: ArrayLike) -> Array:
        """Values (...) at points (..., 2)."""
        return interpolate_grid(self._grid, self._values, xy)


class HeightField:
    """Heights `(ny, nx)` [m] at `origin` + `spacing_m` * (column, row), with two triangles per cell.

    Each cell is split along the diagonal from its lower left to its upper right corner. Queries are exact on
    these triangles, so they agree with the mesh used by physics and ray casting. A point outside gets the
    value of the nearest point of the edge, and NaN that of the first corner.
    """

    def __init__(self, heights: ArrayLike, spacing_m: float, origin: tuple[float, float]) -> None:
        grid = np.array(heights, dtype=np.float64)
        if grid.ndim != 2 or min(grid.shape) < 2:
            raise ValueError(f"heights must be a grid of at least 2 by 2, not of shape {grid.shape}")
        if not np.isfinite(grid).all():
            raise ValueError("heights must be finite")
        if not spacing_m > 0:
            raise ValueError(f"spacing_m must be positive, not {spacing_m}")
        grid.flags.writeable = False
        self.heights: Array = grid
        self.spacing_m = float(spacing_m)
        self.origin = (float(origin[0]), float(origin[1]))
        rows, columns = grid.shape
        self.extent: tuple[float, float, float, float] = (
            self.origin[0],
            self.origin[0] + (columns - 1) * self.spacing_m,
            self.origin[1],
            self.origin[1] + (rows - 1) * self.spacing_m,
        )
        self._grid = grid_of(rows, columns, self.spacing_m, self.origin)
        self._planes, self._normals = self._triangle_tables()

    def _triangle_tables(self) -> tuple[Array, Array]:
        # Two rows per cell, upper left triangle first: height at the cell's lower left corner, rise per cell
        # along x and y, and unit normal. A query of a point is then one table look-up.
        z = self.heights
        low_left, low_right, up_left, up_right = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
        planes = np.empty((*low_left.shape, 2, 3))
        planes[..., 0] = low_left[..., None]
        planes[..., 0, 1], planes[..., 0, 2] = up_right - up_left, up_left - low_left
        planes[..., 1, 1], planes[..., 1, 2] = low_right - low_left, up_right - low_right
        normals = np.empty_like(planes)
        normals[..., :2] = -planes[..., 1:] / self.spacing_m
        normals[..., 2] = 1.0
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return planes.reshape(-1, 3), normals.reshape(-1, 3)

    def height(self, xy: ArrayLike) -> Array:
        """Height [m], shape (...), at points (..., 2)."""
        points = np.ascontiguousarray(xy, np.float64)
        found = np.empty(points.shape[:-1])
        _interpolate_triangles(points.reshape(-1, 2), *self._grid, self._planes, found.reshape(-1))
        height: Array = found[()]
        return height

    def normal(self, xy: ArrayLike) -> Array:
        """Upward unit normal in the world frame, shape (..., 3), at points (..., 2)."""
        return self._normals[self._find_triangles(xy)[0]]

    def height_and_normal(self, xy: ArrayLike) -> tuple[Array, Array]:
        """`height` and `normal`."""
        triangles, height = self._find_triangles(xy)
        return height, self._normals[triangles]

    def slope(self, xy: ArrayLike) -> Array:
        """Angle between the ground and the horizontal [rad], shape (...), at points (..., 2)."""
        return self._slopes[self._find_triangles(xy)[0]]

    def _find_triangles(self, xy: ArrayLike) -> tuple[NDArray[np.int64], Array]:
        points = np.ascontiguousarray(xy, np.float64)
        triangles, found = np.empty(points.shape[:-1], np.int64), np.empty(points.shape[:-1])
        _find_triangles(
            points.reshape(-1, 2), *self._grid, self._planes, triangles.reshape(-1), found.reshape(-1)
        )
        return triangles, found[()]

    @cached_property
    def _slopes(self) -> Array:
        return np.arccos(np.minimum(self._normals[:, 2], 1.0))

    def mesh(self) -> tuple[Array, NDArray[np.int32]]:
        """Vertices (V, 3) [m] and faces (F, 3), counter-clockwise seen from above."""
        rows, columns = self.heights.shape
        x = self.origin[0] + self.spacing_m * np.arange(columns)
        y = self.origin[1] + self.spacing_m * np.arange(rows)
        grid_x, grid_y = np.meshgrid(x, y)
        vertices = np.stack([grid_x, grid_y, self.heights], axis=-1).reshape(-1, 3)
        corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
        upper = np.stack([corner, corner + columns + 1, corner + columns], axis=-1)
        lower = np.stack([corner, corner + 1, corner + columns + 1], axis=-1)
        faces = np.stack([upper, lower], axis=1).reshape(-1, 3).astype(np.int32)
        return vertices, faces


@compile_function
def _locate(point: Any, origin: Any, inverse_spacing: float, last: Any) -> Any:
    """Column and row of the cell that has `point` (2,), and x and y in it, in [0, 1]."""
    x = min(max((point[0] - origin[0]) * inverse_spacing, 0.0), last[0])
    y = min(max((point[1] - origin[1]) * inverse_spacing, 0.0), last[1])
    # NaN compares false.
    x, y = x if x >= 0.0 else 0.0, y if y >= 0.0 else 0.0
    column, row = min(np.int64(x), np.int64(last[0]) - 1), min(np.int64(y), np.int64(last[1]) - 1)
    return column, row, x - column, y - row


@compile_function
def _interpolate_triangles(
    points: Any, origin: Any, inverse_spacing: float, last: Any, planes: Any, found: Any
) -> None:
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        plane = planes[2 * (row * np.int64(last[0]) + column) + (1 if x >= y else 0)]
        found[point] = plane[0] + plane[1] * x + plane[2] * y


@compile_function
def _find_triangles(
    points: Any, origin: Any, inverse_spacing: float, last: Any, planes: Any, triangles: Any, found: Any
) -> None:
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        triangle = 2 * (row * np.int64(last[0]) + column) + (1 if x >= y else 0)
        triangles[point] = triangle
        plane = planes[triangle]
        found[point] = plane[0] + plane[1] * x + plane[2] * y


@compile_function
def _interpolate_bilinear(
    points: Any, origin: Any, inverse_spacing: float, last: Any, values: Any, found: Any
) -> None:
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        columns = np.int64(last[0]) + 1
        corner = row * columns + column
        low = values[corner] * (1.0 - x) + values[corner + 1] * x
        high = values[corner + columns] * (1.0 - x) + values[corner + columns + 1] * x
        found[point] = low * (1.0 - y) + high * y
