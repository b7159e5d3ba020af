"""Where bodies of a size can be: ground that is too steep or too deep under water, obstacles, and roofs.

The fields are made once for each world and kept with it (`World.memoize`).
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import GridField
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.clearance import ClearanceField
from dune_rl.worlds.props import merge_meshes
from dune_rl.worlds.world import World

_CELL_M = 0.25
_MAX_CELLS = 1_000_000
# Where the whole world can be crossed.
_FAR_M = 1e6


@dataclass(frozen=True)
class GroundLimits:
    """The ground that a body can stand on.

    Slopes are those of ground levelled over the body's `reach_m`, so that what is smaller than the body does
    not stop it. Ground is too rough where it differs from its level by more than `roughness_m`.
    """

    max_slope_deg: float
    max_water_m: float
    reach_m: float
    roughness_m: float = 1e3


def ground_passage(world: World, limits: GroundLimits) -> GridField | None:
    """Distance [m] into ground that a body of `limits` can be on: negative where it cannot be.

    None in a world that it can cross everywhere.
    """
    return world.memoize(("ground passage", limits), lambda: _measure_passage(world, limits))


def body_clearance(world: World, height_m: float) -> ClearanceField:
    """As `World.clearance`, for bodies of `height_m` that do not pass below what is lower, decks included."""

    def measure() -> ClearanceField:
        solid = [prop.mesh for prop in world.props if prop.solid]
        return ClearanceField(world.terrain, solid, top_m=height_m)

    return world.memoize(("body clearance", height_m), measure)


def roof_height(world: World, reach_m: float) -> GridField:
    """Height [m] of the highest ground or solid prop within about `reach_m` of points."""
    return world.memoize(("roof", reach_m), lambda: _measure_roof(world, reach_m))


def water_depth(world: World, xy: Array) -> Array:
    """Depth [m] of the water, (...), at points (..., 2); 0 on dry land."""
    points = xy.reshape(-1, 2)
    level = _height_of_first([prop.mesh for prop in world.props if prop.kind == "water"], points)
    return np.maximum(level - world.terrain.height(points), 0.0).reshape(xy.shape[:-1])


def _height_of_first(meshes: list[tuple[Array, NDArray[np.int32]]], points: Array) -> Array:
    """Height [m], (P,), of the highest surface of `meshes` at points (P, 2); -inf where there is none."""
    if not meshes:
        return np.full(len(points), -np.inf)
    return RayScene(*merge_meshes(meshes)).topmost(points)


def _lattice(world: World) -> tuple[Array, Array, float]:
    """Points (rows, columns, 2) [m] of a grid over the world, its origin (2,) and its cell [m]."""
    xmin, xmax, ymin, ymax = world.extent
    cell = max(_CELL_M, float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MAX_CELLS)))
    x = np.arange(xmin, xmax + cell, cell)
    y = np.arange(ymin, ymax + cell, cell)
    return np.stack(np.meshgrid(x, y), axis=-1), np.array([xmin, ymin]), cell


def _measure_passage(world: World, limits: GroundLimits) -> GridField | None:
    points, origin, cell = _lattice(world)
    heights = world.terrain.height(points)
    window = 1 + 2 * round(limits.reach_m / cell)
    level = scipy.ndimage.uniform_filter(heights, window, mode="nearest")
    along_y, along_x = np.gradient(level, cell)
    passable: Flags = np.hypot(along_x, along_y) <= np.tan(np.deg2rad(min(limits.max_slope_deg, 89.9)))
    low = scipy.ndimage.minimum_filter(heights - level, window)
    high = scipy.ndimage.maximum_filter(heights - level, window)
    passable &= (high <= limits.roughness_m) & (low >= -limits.roughness_m)
    depth = water_depth(world, points)
    if depth.any():
        passable &= scipy.ndimage.maximum_filter(depth, window, mode="nearest") <= limits.max_water_m
    if passable.all():
        return None
    inside = scipy.ndimage.distance_transform_edt(passable, sampling=cell)
    outside = scipy.ndimage.distance_transform_edt(~passable, sampling=cell)
    # Half a cell each, so that the border lies between a point that can be crossed and one that cannot.
    signed = np.where(passable, inside - cell / 2, cell / 2 - outside)
    return GridField(signed if passable.any() else np.full(passable.shape, -_FAR_M), origin, cell)


def _measure_roof(world: World, reach_m: float) -> GridField:
    points, origin, cell = _lattice(world)
    solid = [prop.mesh for prop in world.props if prop.solid]
    above = _height_of_first(solid, points.reshape(-1, 2)).reshape(points.shape[:-1])
    top = np.maximum(above, world.terrain.height(points))
    # A thin post can stand between the points of the grid: the vertices of props count too.
    for vertices, _ in solid:
        columns, rows = np.round((vertices[:, :2] - origin) / cell).astype(int).T
        known = (rows >= 0) & (rows < top.shape[0]) & (columns >= 0) & (columns < top.shape[1])
        np.maximum.at(top, (rows[known], columns[known]), vertices[known, 2])
    width = 1 + 2 * int(np.ceil(reach_m / cell + 0.5))
    return GridField(scipy.ndimage.maximum_filter(top, width), origin, cell)


Value = TypeVar("Value", bound=np.generic)

_MAX_CELLS = 4_000_000
_CELLS_AT_ONCE = 16_384


class FreeSpace:
    """Grid over the world that marks traversable cells and labels their connected components.

    A cell is traversable if slope and clearance at its centre admit a round robot of `footprint_radius_m`, at
    least `edge_m` from the world's edge and not on or under a drivable prop. `components` (rows, columns) is
    0 for cells that are not traversable, else the number of the 4-connected component. The grid covers a
    `window` (xmin, xmax, ymin, ymax) [m] of the world; None: all of it.
    """

    def __init__(
        self,
        world: World,
        footprint_radius_m: float,
        max_slope_deg: float,
        *,
        cell_m: float = 0.1,
        edge_m: float = 1.0,
        window: tuple[float, float, float, float] | None = None,
    ) -> None:
        xmin, xmax, ymin, ymax = world.extent if window is None else window
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
        xmin, xmax, ymin, ymax = world.extent
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
        return cells[np.where(inside, row, 0), np.where(inside, column, 0)] * inside
