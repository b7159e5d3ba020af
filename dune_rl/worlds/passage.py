"""Where bodies of a size can be: ground that is too steep or too deep under water, obstacles, and roofs.

The fields are made once for each world and kept with it (`World.memoize`).
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.grid_loops import interpolate_bilinear
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


class GridField:
    """Callable: values between the points of a regular grid, which is that of its edge beyond it."""

    def __init__(self, values: NDArray[np.floating], origin: Array, cell_m: float) -> None:
        rows, columns = values.shape
        self._values = np.ascontiguousarray(values, np.float64).reshape(-1)
        self._grid = origin, 1.0 / cell_m, np.array([columns - 1, rows - 1], np.float64)

    def __call__(self, xy: Array) -> Array:
        """Values (...) at points (..., 2)."""
        points = np.ascontiguousarray(xy, np.float64)
        found = np.empty(points.shape[:-1])
        interpolate_bilinear(points.reshape(-1, 2), *self._grid, self._values, found.reshape(-1))
        return found


def ground_passage(world: World, limits: GroundLimits) -> GridField | None:
    """Distance [m] into ground that a body of `limits` can be on: negative where it cannot be.

    None in a world that it can cross everywhere.
    """
    return world.memoize(("ground passage", limits), lambda: _measure_passage(world, limits))


def body_clearance(world: World, height_m: float) -> ClearanceField:
    """As `World.clearance`, for bodies of `height_m` that do not pass below what is lower, decks included."""

    def measure() -> ClearanceField:
        solid = [(prop.vertices, prop.faces) for prop in world.props if prop.solid]
        return ClearanceField(world.terrain, solid, top_m=height_m)

    return world.memoize(("body clearance", height_m), measure)


def roof_height(world: World, reach_m: float) -> GridField:
    """Height [m] of the highest ground or solid prop within about `reach_m` of points."""
    return world.memoize(("roof", reach_m), lambda: _measure_roof(world, reach_m))


def water_depth(world: World, xy: Array) -> Array:
    """Depth [m] of the water, (...), at points (..., 2); 0 on dry land."""
    points = xy.reshape(-1, 2)
    level = _height_of_first(
        [(prop.vertices, prop.faces) for prop in world.props if prop.kind == "water"], points
    )
    depth: Array = np.maximum(level - world.terrain.height(points), 0.0)
    return depth.reshape(xy.shape[:-1])


def _height_of_first(meshes: list[tuple[Array, NDArray[np.int32]]], points: Array) -> Array:
    """Height [m], (P,), of the highest surface of `meshes` at points (P, 2); -inf where there is none."""
    if not meshes:
        return np.full(len(points), -np.inf)
    vertices, faces = merge_meshes(meshes)
    top = float(vertices[:, 2].max()) + 1.0
    reach = top - float(vertices[:, 2].min()) + 1.0
    return RayScene(vertices, faces).topmost(points, top, reach)


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
    low, high = (
        scipy.ndimage.minimum_filter(heights - level, window),
        scipy.ndimage.maximum_filter(heights - level, window),
    )
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
    solid = [(prop.vertices, prop.faces) for prop in world.props if prop.solid]
    top = np.maximum(
        _height_of_first(solid, points.reshape(-1, 2)).reshape(points.shape[:-1]),
        world.terrain.height(points),
    )
    # A thin post can stand between the points of the grid: the vertices of props count too.
    for vertices, _ in solid:
        columns, rows = np.round((vertices[:, :2] - origin) / cell).astype(int).T
        known = (rows >= 0) & (rows < top.shape[0]) & (columns >= 0) & (columns < top.shape[1])
        np.maximum.at(top, (rows[known], columns[known]), vertices[known, 2])
    return GridField(
        scipy.ndimage.maximum_filter(top, 1 + 2 * int(np.ceil(reach_m / cell + 0.5))), origin, cell
    )
