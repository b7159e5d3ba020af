"""What may be asked of a world's surface beside its height and slope: worked out once on grids."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt
from scipy.signal import oaconvolve

from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.clearance import ClearanceField

Array = NDArray[np.float64]

# Lattice spacings in a radius: 197 points in a disc.
_RESOLUTION = 8
_MAX_POINTS = 4_000_000
_LEAST_RESOLUTION = 3


class NearestObstacle(NamedTuple):
    """`distance` (...) [m] of it and its `point` (..., 2); inf and NaN where there is none."""

    distance: Array
    point: Array


class ObstacleSearch:
    """Callable: the nearest obstacle of any points, as a `ClearanceField` has it."""

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
        """That of points (..., 2); beyond the world's edge, that of the edge's nearest point."""
        points = np.asarray(xy, dtype=np.float64)
        distance = self._field(points)
        if self._nearest is None:
            return NearestObstacle(distance, np.full(points.shape, np.nan))
        row, column = np.divmod(self._nearest[self._field.nearest_cell(points)], self._field.columns)
        point = np.empty(points.shape)
        xmin, ymin = self._field.origin
        point[..., 0] = xmin + self._field.cell_m * column
        point[..., 1] = ymin + self._field.cell_m * row
        # Who is inside one is at it.
        inside = distance == 0.0
        point[inside] = points[inside]
        return NearestObstacle(distance, point)


class RoughnessField:
    """Callable: the roughness [m] of the ground within `radius_m` of any points.

    That is the root mean square height about the plane that fits best, by least squares, in a disc seen
    from above: the RMS height of detrended heights in Shepard et al., The roughness of natural terrain,
    J. Geophys. Res. Planets 106 (2001), 32777-32795. It is worked out on a lattice, an eighth of the radius
    fine (coarser in a wide world), and interpolated. Beyond the edge the ground goes on as high as the edge.
    """

    def __init__(self, terrain: HeightField, radius_m: float) -> None:
        xmin, xmax, ymin, ymax = terrain.extent
        least = float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MAX_POINTS))
        self._step = max(radius_m / _RESOLUTION, least)
        if not radius_m >= _LEAST_RESOLUTION * self._step:
            raise ValueError(
                f"radius_m={radius_m:g} is too small for a world of {xmax - xmin:g} by {ymax - ymin:g} m: "
                f"take {_LEAST_RESOLUTION * least:.2g} or more"
            )
        reach = int(radius_m / self._step + 1e-9)
        cells = np.ceil(np.array([xmax - xmin, ymax - ymin]) / self._step).astype(int)
        columns, rows = (np.arange(-reach, count + reach + 1) * self._step for count in cells)
        lattice = np.stack(np.meshgrid(xmin + columns, ymin + rows), axis=-1)
        offsets = self._step * np.arange(-reach, reach + 1, dtype=np.float64)
        disc = np.hypot(offsets[:, None], offsets) <= radius_m + 1e-9
        rms = _about_plane(terrain.height(lattice), disc, offsets)
        self._origin = np.array([xmin, ymin])
        self._columns = rms.shape[1]
        self._last = np.array([rms.shape[1] - 1, rms.shape[0] - 1], dtype=np.float64)
        self._rms = rms.astype(np.float32).reshape(-1)

    def __call__(self, xy: ArrayLike) -> Array:
        """Roughness [m], shape (...), at points (..., 2)."""
        at = (np.asarray(xy, dtype=np.float64) - self._origin) * (1.0 / self._step)
        return interpolated(self._rms, self._columns, self._last, at)


def interpolated(values: NDArray[np.float32], columns: int, last: Array, at: Array) -> Array:
    """Values (...) of a flat grid `columns` wide at places `at` (..., 2) in cells, held within `last`."""
    at = np.fmin(np.fmax(at, 0.0), last)
    cell = np.minimum(at.astype(np.intp), last.astype(np.intp) - 1)
    at = at - cell
    x, y = at[..., 0], at[..., 1]
    corner = cell[..., 1] * columns + cell[..., 0]
    low = values[corner] * (1 - x) + values[corner + 1] * x
    high = values[corner + columns] * (1 - x) + values[corner + columns + 1] * x
    result: Array = low * (1 - y) + high * y
    return result


def _about_plane(heights: Array, disc: NDArray[np.bool_], offsets: Array) -> Array:
    """RMS of heights (rows, columns) about the plane of best fit, wherever the whole disc fits."""
    count = float(disc.sum())
    ones = disc.astype(np.float64)

    def summed(values: Array, weights: Array) -> Array:
        found: Array = oaconvolve(values, weights[::-1, ::-1], mode="valid")
        return found

    middle = heights - heights.mean()
    mean = summed(middle, ones) / count
    spread = float((ones * offsets**2).sum())
    # The disc is the same on every side, so that mean and both slopes are found one by one.
    slope_x = summed(middle, ones * offsets) / spread
    slope_y = summed(middle, ones * offsets[:, None]) / spread
    variance = summed(middle**2, ones) / count - mean**2 - (slope_x**2 + slope_y**2) * (spread / count)
    root: Array = np.sqrt(np.maximum(variance, 0.0))
    return root
