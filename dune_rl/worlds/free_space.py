"""Where a robot can stand, and which places are joined."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from dune_rl.worlds.world import World

Array = NDArray[np.float64]

_MAX_CELLS = 4_000_000


class FreeSpace:
    """A grid over the world that tells its traversable cells, and labels its connected parts.

    A cell is traversable when the slope and the clearance at its centre allow a
    round robot of `footprint_radius_m` to stand there, `edge_m` or more from
    the world's edge and not on or under a drivable prop. `parts` (rows, columns)
    is 0 where it is not, and else the number of the part it belongs to: cells
    joined by their sides are of one part.
    """

    def __init__(
        self,
        world: World,
        footprint_radius_m: float,
        max_slope_deg: float,
        *,
        cell_m: float = 0.1,
        edge_m: float = 1.0,
    ) -> None:
        xmin, xmax, ymin, ymax = world.extent
        self.cell_m = max(cell_m, float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MAX_CELLS)))
        self.x: Array = np.arange(xmin + self.cell_m / 2, xmax, self.cell_m)
        self.y: Array = np.arange(ymin + self.cell_m / 2, ymax, self.cell_m)
        centres = np.stack(np.meshgrid(self.x, self.y), axis=-1)
        self.clearance: Array = world.clearance(centres)
        self.steep: NDArray[np.bool_] = world.terrain.slope(centres) > np.deg2rad(max_slope_deg)
        self.blocked: NDArray[np.bool_] = self.clearance < footprint_radius_m
        for prop in world.props:
            if prop.solid and prop.drivable:
                low, high = prop.vertices.min(axis=0), prop.vertices.max(axis=0)
                centre, reach = (low + high) / 2, (high - low) / 2 + footprint_radius_m
                over_x = np.abs(self.x - centre[0]) < reach[0]
                over_y = np.abs(self.y - centre[1]) < reach[1]
                self.blocked |= over_y[:, None] & over_x
        inside_x = (self.x >= xmin + edge_m) & (self.x <= xmax - edge_m)
        inside_y = (self.y >= ymin + edge_m) & (self.y <= ymax - edge_m)
        self.inside: NDArray[np.bool_] = inside_y[:, None] & inside_x
        self.traversable: NDArray[np.bool_] = self.inside & ~self.steep & ~self.blocked
        self.parts: NDArray[np.int32]
        self.parts, self.part_count = label(self.traversable)

    def centres(self, cells: NDArray[np.bool_]) -> Array:
        """Centres (K, 2) [m] of the cells that are True in a grid (rows, columns)."""
        rows, columns = np.nonzero(cells)
        return np.stack([self.x[columns], self.y[rows]], axis=-1)

    def part(self, xy: ArrayLike) -> NDArray[np.int32]:
        """The number of the part, shape (...), that points (..., 2) lie in; 0 for none."""
        points = np.asarray(xy, dtype=np.float64)
        column = np.floor((points[..., 0] - self.x[0]) / self.cell_m + 0.5).astype(int)
        row = np.floor((points[..., 1] - self.y[0]) / self.cell_m + 0.5).astype(int)
        known = (column >= 0) & (column < len(self.x)) & (row >= 0) & (row < len(self.y))
        return np.where(known, self.parts[np.where(known, row, 0), np.where(known, column, 0)], 0)
