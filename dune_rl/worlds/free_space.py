"""Grid of the positions that a robot can occupy, with its connected components."""

from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.worlds.world import World

Value = TypeVar("Value", bound=np.generic)

_MAX_CELLS = 4_000_000
_CELLS_AT_ONCE = 16_384


class FreeSpace:
    """Grid over the world that marks traversable cells and labels their connected components.

    A cell is traversable if slope and clearance at its centre admit a round
    robot of `footprint_radius_m`, at least `edge_m` from the world's edge and
    not on or under a drivable prop. `components` (rows, columns) is 0 for cells
    that are not traversable, else the number of the 4-connected component.
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
        self.clearance: Array = np.empty((len(self.y), len(self.x)))
        self.steep: Flags = np.empty(self.clearance.shape, bool)
        # In parts: what queries need on the way is ten times as large as what they give.
        rows = max(1, _CELLS_AT_ONCE // len(self.x))
        for first in range(0, len(self.y), rows):
            part = slice(first, first + rows)
            centres = np.stack(np.meshgrid(self.x, self.y[part]), axis=-1)
            self.clearance[part] = world.clearance(centres)
            self.steep[part] = world.terrain.slope(centres) > np.deg2rad(max_slope_deg)
        self.blocked: Flags = self.clearance < footprint_radius_m
        for prop in world.props:
            if prop.solid and prop.drivable:
                low, high = prop.vertices.min(axis=0), prop.vertices.max(axis=0)
                centre, reach = (low + high) / 2, (high - low) / 2 + footprint_radius_m
                over_x = np.abs(self.x - centre[0]) < reach[0]
                over_y = np.abs(self.y - centre[1]) < reach[1]
                self.blocked |= over_y[:, None] & over_x
        inside_x = (self.x >= xmin + edge_m) & (self.x <= xmax - edge_m)
        inside_y = (self.y >= ymin + edge_m) & (self.y <= ymax - edge_m)
        self.inside: Flags = inside_y[:, None] & inside_x
        self.traversable: Flags = self.inside & ~self.steep & ~self.blocked
        self.components: NDArray[np.int32]
        self.components, _ = scipy.ndimage.label(self.traversable)

    def centres(self, cells: Flags) -> Array:
        """Centres (K, 2) [m] of the True cells of a grid (rows, columns)."""
        rows, columns = np.nonzero(cells)
        return np.stack([self.x[columns], self.y[rows]], axis=-1)

    def component_at(self, xy: ArrayLike) -> NDArray[np.int32]:
        """Component numbers (...) at points (..., 2); 0 where not traversable."""
        return self.values_at(self.components, xy)

    def values_at(self, cells: NDArray[Value], xy: ArrayLike) -> NDArray[Value]:
        """Values (...) of a grid `cells` (rows, columns) at points (..., 2); 0 or False outside."""
        points = np.asarray(xy, dtype=np.float64)
        index = np.floor((points - [self.x[0], self.y[0]]) / self.cell_m + 0.5).astype(int)
        column, row = index[..., 0], index[..., 1]
        inside = (column >= 0) & (column < len(self.x)) & (row >= 0) & (row < len(self.y))
        found: NDArray[Value] = cells[np.where(inside, row, 0), np.where(inside, column, 0)] * inside
        return found
