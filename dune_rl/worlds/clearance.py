"""Distance to the nearest obstacle, computed once on a grid and interpolated."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.grid_loops import interpolate_bilinear
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.props import Mesh, merge_meshes

# Every robot of the package drives over what is lower, and under what is higher.
BAND_BOTTOM_M = 0.03
BAND_TOP_M = 0.45

_CELL_M = 0.05
_MAX_CELLS = 4_000_000
_RAY_RANGE_M = 100.0
_MAX_CROSSINGS = 32


class ClearanceField:
    """Callable: distance [m] from points to the nearest obstacle; 0 inside one, inf without obstacles.

    `blocking` are the closed meshes of obstacles, `decks` those that count as
    ground. Cells are 0.05 m (larger in worlds over 100 m). Distances are on
    average half a cell too short, and at most half a cell too long. Obstacles
    are what occupies the heights from 0.03 m to `top_m` above the ground.
    """

    def __init__(
        self,
        terrain: HeightField,
        blocking: Sequence[Mesh],
        decks: Sequence[Mesh] = (),
        top_m: float = BAND_TOP_M,
    ) -> None:
        self._band_m = top_m - BAND_BOTTOM_M
        xmin, xmax, ymin, ymax = terrain.extent
        self.cell_m = max(_CELL_M, float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MAX_CELLS)))
        self.columns = int(np.ceil((xmax - xmin) / self.cell_m)) + 1
        self.rows = int(np.ceil((ymax - ymin) / self.cell_m)) + 1
        self._terrain = terrain
        self._origin = np.array([xmin, ymin])
        self._inverse_cell = 1.0 / self.cell_m
        self._last = np.array([self.columns - 1, self.rows - 1], dtype=np.float64)
        self._strides = np.array([1, self.columns])
        self.distance: Floats | None = self._build(blocking, decks) if blocking else None

    def _build(self, blocking: Sequence[Mesh], decks: Sequence[Mesh]) -> Floats | None:
        rows, columns = np.nonzero(self._in_bounding_boxes(blocking))
        xy = self._origin + self.cell_m * np.stack([columns, rows], axis=-1)
        ground = self._terrain.height(xy)
        scene = RayScene(*merge_meshes(blocking))
        blocked = _is_band_occupied(scene, xy, ground, self._band_m)
        if decks:
            top = RayScene(*merge_meshes(decks)).topmost(xy, 0.5 * _RAY_RANGE_M, 2 * _RAY_RANGE_M)
            above = top > ground
            blocked[above] |= _is_band_occupied(scene, xy[above], top[above], self._band_m)
        if not blocked.any():
            return None
        free = np.ones((self.rows, self.columns), dtype=bool)
        free[rows[blocked], columns[blocked]] = False
        # An obstacle's true edge is up to a cell beyond its outermost grid point.
        distance = scipy.ndimage.distance_transform_edt(free, sampling=self.cell_m) - self.cell_m
        return np.maximum(distance, 0.0).astype(np.float32).reshape(-1)

    def _in_bounding_boxes(self, meshes: Sequence[Mesh]) -> Flags:
        near = np.zeros((self.rows, self.columns), dtype=bool)
        for vertices, _ in meshes:
            low = np.floor((vertices[:, :2].min(axis=0) - self._origin) * self._inverse_cell)
            high = np.ceil((vertices[:, :2].max(axis=0) - self._origin) * self._inverse_cell)
            (left, bottom), (right, top) = np.maximum(low, 0).astype(int), np.maximum(high + 1, 0).astype(int)
            near[bottom:top, left:right] = True
        return near

    @property
    def origin(self) -> Array:
        """The grid point (2,) [m] of lowest x and y."""
        return self._origin

    def nearest_cell(self, xy: ArrayLike) -> NDArray[np.intp]:
        """Index (...) in `distance` of the grid point nearest to points (..., 2)."""
        at = (np.asarray(xy, dtype=np.float64) - self._origin) * self._inverse_cell
        at = np.fmin(np.fmax(at, 0.0), self._last)
        return (at + 0.5).astype(np.intp) @ self._strides

    def __call__(self, xy: ArrayLike) -> Array:
        """Clearance [m], shape (...), at points (..., 2); outside the world, that of its edge."""
        points = np.asarray(xy, dtype=np.float64)
        if self.distance is None:
            return np.full(points.shape[:-1], np.inf)
        found = np.empty(points.shape[:-1])
        flat = np.ascontiguousarray(points).reshape(-1, 2)
        grid = self._origin, self._inverse_cell, self._last
        interpolate_bilinear(flat, *grid, self.distance, found.reshape(-1))
        clearance: Array = found[()]
        return clearance


def _is_band_occupied(scene: RayScene, xy: Array, ground: Array, band_m: float) -> Flags:
    # A surface within the band is an obstacle, and so is a solid that the band's bottom is in.
    start = ground + BAND_BOTTOM_M
    first, balance = cross_upwards(scene, xy, start, _RAY_RANGE_M, _MAX_CROSSINGS)
    occupied: Flags = (first - start < band_m) | (balance > 0)
    return occupied


def cross_upwards(
    scene: RayScene, xy: Array, z: Array, range_m: float, most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Height [m], (N,), just above the first surface over points (N, 2) at heights `z` (N,), inf for none.

    Also returns how much more often upward rays leave solids than enter them, (N,): above 0 inside a solid.
    Surfaces farther than `range_m` from the one before, and those after the first `most`, do not count.
    """
    height, first = z.copy(), np.full(len(xy), np.inf)
    balance, live = np.zeros(len(xy), np.int64), np.arange(len(xy))
    for _ in range(most):
        origins = np.column_stack([xy[live], height[live]])
        hit, normal = scene.first_hit(origins, np.broadcast_to([0.0, 0.0, 1.0], origins.shape), range_m)
        found = hit < range_m
        live, hit, normal = live[found], hit[found], normal[found]
        if not len(live):
            break
        height[live] += hit + 1e-4
        first[live] = np.minimum(first[live], height[live])
        balance[live] += np.sign(normal[:, 2]).astype(int)
    return first, balance


class NearestObstacle(NamedTuple):
    """Distances (...) [m] to nearest obstacles, and their points (..., 2); inf and NaN without obstacles."""

    distance: Array
    point: Array


class ObstacleSearch:
    """Callable: the nearest obstacle of any points, consistent with a `ClearanceField`."""

    def __init__(self, field: ClearanceField) -> None:
        self._field = field
        self._nearest: NDArray[np.int32] | None = None
        if field.distance is None:
            return
        free = field.distance.reshape(field.rows, field.columns) > 0.0
        row, column = scipy.ndimage.distance_transform_edt(
            free, sampling=field.cell_m, return_distances=False, return_indices=True
        )
        self._nearest = (row * field.columns + column).astype(np.int32).reshape(-1)

    def __call__(self, xy: ArrayLike) -> NearestObstacle:
        """Nearest obstacles of points (..., 2); outside the world, those of the edge's nearest point."""
        points = np.asarray(xy, dtype=np.float64)
        distance = self._field(points)
        if self._nearest is None:
            return NearestObstacle(distance, np.full(points.shape, np.nan))
        row, column = np.divmod(self._nearest[self._field.nearest_cell(points)], self._field.columns)
        point = np.empty(points.shape)
        xmin, ymin = self._field.origin
        point[..., 0] = xmin + self._field.cell_m * column
        point[..., 1] = ymin + self._field.cell_m * row
        # A point inside an obstacle is its own nearest point.
        inside = distance == 0.0
        point[inside] = points[inside]
        return NearestObstacle(distance, point)
