"""Horizontal distance to the nearest static obstacle, from a grid that all scenes of a world share."""

from collections.abc import Iterator
from weakref import WeakValueDictionary

import numpy as np
from scipy.ndimage import distance_transform_edt

from dune_rl.geometry.arrays import Array
from dune_rl.physics.gate_loops import find_boxes, find_distance
from dune_rl.physics.shapes import StaticBody

_CELL_M = 0.1
_MAX_CELLS = 1_000_000
# Points on surfaces that are computed at once.
_MAX_POINTS = 200_000


class ObstacleMap:
    """Lower bound of the distance, seen from above, from any point to the triangles of static obstacles.

    The bound is less than the distance by at most four cells of `cell_m`, which is 0.1 m, or more where the
    obstacles' bounding box would have more than a million cells.
    """

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        # `load_shared_map` finds maps by the id of this tuple, which must not be reused.
        self._statics = statics
        numbers = [number for number, body in enumerate(statics) if not body.ground and len(body.faces)]
        obstacles = [statics[number] for number in numbers]
        corners = [(body.vertices[:, :2].min(axis=0), body.vertices[:, :2].max(axis=0)) for body in obstacles]
        self._numbers = np.array(numbers, np.int64)
        self._boxes = np.array(corners).reshape(-1, 4)
        # What `gate_loops` calls `grid` and `quarters`; without obstacles there are none.
        self.arrays = np.zeros(6), np.zeros(0, np.uint8)
        if not obstacles:
            return
        vertices = np.concatenate([body.vertices[:, :2] for body in obstacles])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        width, depth = high - low
        self.cell_m = max(_CELL_M, float(np.sqrt(width * depth / _MAX_CELLS)))
        columns, rows = (int(size / self.cell_m) + 2 for size in (width, depth))
        free = np.ones((columns, rows), bool)
        for body in obstacles:
            for points in _surface_points(body.vertices[body.faces][..., :2], self.cell_m):
                cells = ((points - low) / self.cell_m).astype(np.int64)
                free[cells[:, 0], cells[:, 1]] = False
        # Query and sample are up to half a cell's diagonal from their cells' centres, and a triangle's point
        # is up to 1/sqrt(3) of the spacing from the nearest sample: two cells together.
        distance = distance_transform_edt(free, sampling=self.cell_m) - 2.0 * self.cell_m
        # In quarters of a cell, rounded down: a byte is enough for the distances that matter.
        quarters = np.clip(4.0 * distance / self.cell_m, 0.0, 255.0).astype(np.uint8)
        grid = np.array([low[0], high[0], low[1], high[1], self.cell_m, rows])
        self.arrays = grid, quarters.reshape(-1)

    def distance(self, x: float, y: float) -> float:
        """Lower bound [m] for a point, whose coordinates must be finite; inf without obstacles."""
        return float(find_distance(*self.arrays, x, y))

    def bodies_near(self, x: float, y: float, distance_m: float) -> list[int]:
        """Numbers, among the statics, of obstacles with bounding boxes within a distance along x and y."""
        found = np.empty(len(self._numbers), np.int64)
        count = find_boxes(self._boxes, x, y, distance_m, found)
        near: list[int] = self._numbers[found[:count]].tolist()
        return near


def _surface_points(triangles: Array, spacing_m: float) -> Iterator[Array]:
    """Points (P, 2) [m] on triangles (F, 3, 2), in batches of bounded size.

    Any point of a triangle is within `spacing_m` / sqrt(3) of one of them. They are in rows along the longest
    edge, and as few as the triangle is narrow: a wall, which has no area seen from above, has two rows.
    """
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
    first = edges.argmax(axis=1)[:, None]
    a, b, c = np.moveaxis(
        np.take_along_axis(triangles, ((first + np.arange(3)) % 3)[..., None], axis=1), 1, 0
    )
    (base_x, base_y), (side_x, side_y) = (b - a).T, (c - a).T
    longest = edges.max(axis=1)
    height = np.abs(base_x * side_y - base_y * side_x) / np.maximum(longest, 1e-12)
    # Rows are closer than points in a row, as they become shorter. Powers of two, so that a mesh with
    # triangles of many sizes needs few batches.
    sizes = np.stack([longest, 4.0 * height]) / spacing_m
    counts = 2 ** np.ceil(np.log2(np.maximum(sizes, 1.0))).astype(np.int64)
    for along, up in np.unique(counts, axis=1).T.tolist():
        own = np.flatnonzero((counts == [[along], [up]]).all(axis=0))
        shares = np.linspace(0.0, 1.0, along + 1)
        for part in np.array_split(own, max(1, len(own) * (along + 1) // _MAX_POINTS)):
            rows = max(1, _MAX_POINTS // (len(part) * (along + 1)))
            for low in range(0, up + 1, rows):
                heights = np.arange(low, min(low + rows, up + 1))[:, None] / up
                weights = [(1 - heights) * (1 - shares), (1 - heights) * shares, heights + 0.0 * shares]
                corners = np.stack([a[part], b[part], c[part]], axis=1)
                yield (np.stack([weight.ravel() for weight in weights], axis=1) @ corners).reshape(-1, 2)


_maps_by_statics: WeakValueDictionary[int, ObstacleMap] = WeakValueDictionary()


def load_shared_map(statics: tuple[StaticBody, ...]) -> ObstacleMap:
    """The map of `statics`, computed once for all scenes with the same tuple."""
    found = _maps_by_statics.get(id(statics))
    if found is None:
        _maps_by_statics[id(statics)] = found = ObstacleMap(statics)
    return found
