"""Distance to the nearest obstacle, computed once on a grid and interpolated."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField, grid_of, interpolate_grid
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.props import Mesh, bisect_triangles, merge_meshes

# Every robot of the package drives over what is lower, and under what is higher.
BAND_BOTTOM_M = 0.03
BAND_TOP_M = 0.45

_CELL_M = 0.05
_MAX_CELLS = 4_000_000
_RAY_RANGE_M = 100.0
_MAX_CROSSINGS = 32

# Of `SurfaceClearance`.
_COARSE_M = 0.5
# Distance of sample points in cells: at most this, marked cells touch at least at their corners.
_SPACING = 0.7
_POINTS_AT_ONCE = 1_000_000
# Limits of memory; beyond them, cells may be missed.
_MOST_TRIANGLES, _MOST_PIECES = 3_000_000, 64
_SAMPLES_PER_REGION, _MOST_CROSSINGS = 24, 64


class NearestObstacle(NamedTuple):
    """Distances (...) [m] to nearest obstacles, and their points (..., 2); inf and NaN without obstacles."""

    distance: Array
    point: Array


class ClearanceField:
    """Callable: distance [m] from points to the nearest obstacle; 0 inside one, inf without obstacles.

    `blocking` are the closed meshes of obstacles, `decks` those that count as ground. Cells are 0.05 m
    (larger in worlds over 100 m). Distances are on average half a cell too short, and at most half a cell too
    long. Obstacles are what occupies the heights from 0.03 m to `top_m` above the ground.
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
        self._grid = grid_of(self.rows, self.columns, self.cell_m, [xmin, ymin])
        self.distance: Floats | None = self._build(blocking, decks) if blocking else None

    def _build(self, blocking: Sequence[Mesh], decks: Sequence[Mesh]) -> Floats | None:
        rows, columns = np.nonzero(self._in_bounding_boxes(blocking))
        xy = self._points(rows, columns)
        ground = self._terrain.height(xy)
        scene = RayScene(*merge_meshes(blocking))
        blocked = _is_band_occupied(scene, xy, ground, self._band_m)
        if decks:
            top = RayScene(*merge_meshes(decks)).topmost(xy, 0.5 * _RAY_RANGE_M, 2 * _RAY_RANGE_M)
            above = top > ground
            blocked[above] |= _is_band_occupied(scene, xy[above], top[above], self._band_m)
        free = np.ones((self.rows, self.columns), dtype=bool)
        free[rows[blocked], columns[blocked]] = False
        return self._distances(free)

    def _distances(self, free: Flags) -> Floats | None:
        if free.all():
            return None
        # An obstacle's true edge is up to a cell beyond its outermost grid point.
        distance = scipy.ndimage.distance_transform_edt(free, sampling=self.cell_m) - self.cell_m
        return np.maximum(distance, 0.0).astype(np.float32).reshape(-1)

    def _points(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> Array:
        """Points (N, 2) [m] of the grid, by their rows and columns (N,)."""
        return self._grid[0] + self.cell_m * np.stack([columns, rows], axis=-1)

    def _in_bounding_boxes(self, meshes: Sequence[Mesh]) -> Flags:
        near = np.zeros((self.rows, self.columns), dtype=bool)
        origin, per_m, _ = self._grid
        for vertices, _ in meshes:
            low = np.floor((vertices[:, :2].min(axis=0) - origin) * per_m)
            high = np.ceil((vertices[:, :2].max(axis=0) - origin) * per_m)
            (left, bottom), (right, top) = np.maximum(low, 0).astype(int), np.maximum(high + 1, 0).astype(int)
            near[bottom:top, left:right] = True
        return near

    def __call__(self, xy: ArrayLike) -> Array:
        """Clearance [m], shape (...), at points (..., 2); outside the world, that of its edge."""
        if self.distance is None:
            return np.full(np.shape(xy)[:-1], np.inf)
        return interpolate_grid(self._grid, self.distance, xy)

    @cached_property
    def _nearest(self) -> NDArray[np.int32]:
        """Index of the nearest blocked grid point of each grid point, row after row."""
        assert self.distance is not None
        free = self.distance.reshape(self.rows, self.columns) > 0.0
        row, column = scipy.ndimage.distance_transform_edt(
            free, sampling=self.cell_m, return_distances=False, return_indices=True
        )
        return (row * self.columns + column).astype(np.int32).reshape(-1)

    def nearest(self, xy: ArrayLike) -> NearestObstacle:
        """Nearest obstacles of points (..., 2); outside the world, those of the edge's nearest point."""
        points = np.asarray(xy, dtype=np.float64)
        distance = self(points)
        if self.distance is None:
            return NearestObstacle(distance, np.full(points.shape, np.nan))
        origin, per_m, last = self._grid
        at = np.fmin(np.fmax((points - origin) * per_m, 0.0), last)
        cell = (at + 0.5).astype(np.intp) @ [1, self.columns]
        row, column = np.divmod(self._nearest[cell], self.columns)
        # A point inside an obstacle is its own nearest point.
        return NearestObstacle(
            distance, np.where((distance == 0.0)[..., None], points, self._points(row, column))
        )


def _is_band_occupied(scene: RayScene, xy: Array, ground: Array, band_m: float) -> Flags:
    # A surface within the band is an obstacle, and so is a solid that the band's bottom is in.
    start = ground + BAND_BOTTOM_M
    first, balance = cross_upwards(scene, xy, start, _RAY_RANGE_M, _MAX_CROSSINGS)
    return (first - start < band_m) | (balance > 0)


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


class SurfaceClearance(ClearanceField):
    """A `ClearanceField` that marks every cell with a surface in it and fills the interior of closed ones.

    The vertical rays of the base class miss objects thinner than a cell and miscount coincident faces. Here
    they only decide, by majority, whether a region enclosed by surfaces is the interior of an object.
    """

    def _build(self, blocking: Sequence[Mesh], decks: Sequence[Mesh]) -> Floats | None:
        if decks:
            return super()._build(blocking, decks)
        free = np.ones((self.rows, self.columns), bool)
        near = [mesh for mesh in blocking if self._may_be_in_band(mesh[0][mesh[1]]).any()]
        for points in self._sample_surfaces([vertices[faces] for vertices, faces in near]):
            over = points[:, 2] - self._terrain.height(points[:, :2])
            band = points[(over > BAND_BOTTOM_M) & (over < BAND_TOP_M), :2]
            column, row = np.round((band - self._grid[0]) * self._grid[1]).astype(np.intp).T
            inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
            free[row[inside], column[inside]] = False
        if not free.all():
            self._fill_interiors(free, near)
        return self._distances(free)

    def _may_be_in_band(self, corners: Array) -> Flags:
        """Mask of triangles (F, 3, 3) that may reach the height band above the ground within the world."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        xmin, xmax, ymin, ymax = self._terrain.extent
        ground = self._terrain.height(corners[..., :2])
        # The ground below the middle of a triangle differs from that below its corners.
        slack = 1.5 * (high - low)[:, :2].max(axis=1) + 0.1
        near = high[:, 2] > ground.min(axis=1) - slack
        near &= low[:, 2] < ground.max(axis=1) + slack + BAND_TOP_M
        return near & (high[:, :2] >= [xmin, ymin]).all(axis=1) & (low[:, :2] <= [xmax, ymax]).all(axis=1)

    def _sample_surfaces(self, meshes: Sequence[Array]) -> Iterator[Array]:
        """Points (N, 3), less than a cell apart, on the triangles (F, 3, 3) that may be in the band."""
        if not meshes:
            return
        corners = np.concatenate(meshes)
        longest = max(_COARSE_M, 4 * self.cell_m)
        while len(corners):
            # Triangles outside the band are dropped at every size, so few remain of a huge triangle.
            corners = corners[self._may_be_in_band(corners)]
            edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            small = edges.max(axis=1) <= longest
            if len(corners) > _MOST_TRIANGLES:
                small[:] = True
            yield from self._sample_triangles(corners[small], edges[small].max(axis=1))
            corners = bisect_triangles(corners[~small], edges[~small].argmax(axis=1))

    def _sample_triangles(self, corners: Array, edges: Array) -> Iterator[Array]:
        pieces = np.clip(np.ceil(edges / (_SPACING * self.cell_m)), 1, _MOST_PIECES).astype(int)
        for count in np.unique(pieces):
            weights = _barycentric_lattice(int(count))
            chosen = corners[pieces == count]
            step = max(1, _POINTS_AT_ONCE // len(weights))
            for start in range(0, len(chosen), step):
                yield np.einsum("pc,fcx->fpx", weights, chosen[start : start + step]).reshape(-1, 3)

    def _fill_interiors(self, free: Flags, meshes: Sequence[Mesh]) -> None:
        """Remove the regions inside closed surfaces from `free` (rows, columns), in place."""
        labels, count = scipy.ndimage.label(free)
        flat = labels.reshape(-1)
        order = np.argsort(flat, kind="stable")[int((flat == 0).sum()) :]
        sizes = np.bincount(flat, minlength=count + 1)[1:]
        starts = np.cumsum(sizes) - sizes
        # A few cells of each region, spread over it.
        shares = (np.arange(_SAMPLES_PER_REGION) + 0.5) / _SAMPLES_PER_REGION
        samples = order[(starts[:, None] + (shares * sizes[:, None]).astype(np.intp)).reshape(-1)]
        rows, columns = np.divmod(samples, self.columns)
        xy = self._points(rows, columns)
        inside = _is_inside(meshes, xy, self._terrain.height(xy) + (BAND_BOTTOM_M + BAND_TOP_M) / 2)
        is_interior = inside.reshape(count, _SAMPLES_PER_REGION).mean(axis=1) > 0.5
        free &= ~np.concatenate([[False], is_interior])[labels]


def _barycentric_lattice(count: int) -> Array:
    """Barycentric weights (P, 3) of a lattice with `count` intervals per edge."""
    first, second = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    inside = first + second <= count
    return np.stack([first[inside], second[inside], count - first[inside] - second[inside]], axis=1) / count


def _is_inside(meshes: Sequence[Mesh], xy: Array, z: Array) -> Flags:
    """Whether points (N, 2) at heights (N,) are inside closed meshes: upward rays leave more than enter."""
    vertices, faces = merge_meshes(meshes)
    scene = RayScene(vertices, faces)
    far = max(1.0, float(vertices[:, 2].max() - z.min()) + 1.0)
    _, balance = cross_upwards(scene, xy, z, far, _MOST_CROSSINGS)
    return balance > 0
