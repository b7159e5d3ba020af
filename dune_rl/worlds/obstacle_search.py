"""Search for the obstacle nearest to given points, on the grid of a clearance field."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from dune_rl.geometry.arrays import Array
from dune_rl.worlds.clearance import ClearanceField


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
        row, column = distance_transform_edt(
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
