"""Global planning: Dijkstra's algorithm on a grid of the true slopes and obstacles of a world."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.world import World

# Cells of the maps of 25 by 25 m and less, of those of 63 by 63 m, and the most cells beyond 80 by 80 m.
_FINEST_M, _CELL_M = 0.1, 0.2
_MOST_CELLS, _MOST_COARSE_CELLS = 100_000, 160_000
# A map reaches so far beyond start and goal, or by their distance; its sides lie on multiples of a raster.
MARGIN_M, _RASTER_M = 8.0, 4.0
# Maps of windows that are kept with a world: each takes some 20 MB.
_KEPT_MAPS = 2
_EDGE_M = 0.5
# Steps (rows, columns) in half of 16 directions; the others are their opposites. With 16 directions a route
# in the open is at most 2.7 % longer than the shortest, with 8 it is 8.2 %.
_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (2, -1), (1, -2))
# A metre costs 1, and more: on slopes, this at the limit, and beside obstacles, this at contact.
_SLOPE_COST = 2.0
_NEAR_COST = 3.0
_NEAR_M = 0.6
# Where the robot fits only lengthwise, at the narrowest.
_TIGHT_COST = 8.0
# Cost of a metre in cells that are not traversable, from the nearest that is.
_OFF_COST = 10.0
# Cost of places from which no route leads to the goal, beside the straight distance.
_NO_ROUTE_COST = 1_000.0
_REACH = 4.0
# Room that steep ground counts for in the follower, over the footprint's radius.
_STEEP_ROOM = 0.68
# A waypoint lies some steps ahead on a route, which are so long together along an axis.
_WAYPOINT_M = 0.8

Window = tuple[float, float, float, float]


class Routes(NamedTuple):
    """The cheapest routes to a goal from everywhere, (rows, columns) each.

    `cost` is that to go, `waypoint` the number of a cell some steps ahead: four of 0.2 m, eight of 0.1 m.
    `clearance` [m] is that of obstacles and of what was blocked besides; on ground that is too steep it is at
    most 0.68 times the footprint's radius, and grows with the distance from there.
    """

    cost: Floats
    waypoint: NDArray[np.int32]
    clearance: Floats


class RouteMap:
    """Costs of travel of a round robot of `footprint_radius_m` in a world; see `FreeSpace` for what is free.

    It covers a `window` (xmin, xmax, ymin, ymax) [m] of the world, or all of it, by cells of `cell_m`.

    A metre costs 1 on level ground in the open, up to 3 at the slope limit and up to 4 beside an obstacle,
    and up to 12 where the clearance is below the footprint's radius but not below `narrowest_m`.
    It keeps no reference to the world.
    """

    def __init__(
        self,
        world: World,
        footprint_radius_m: float,
        max_slope_deg: float,
        narrowest_m: float | None = None,
        *,
        cell_m: float = _CELL_M,
        window: Window | None = None,
    ) -> None:
        narrowest = footprint_radius_m if narrowest_m is None else min(narrowest_m, footprint_radius_m)
        space = FreeSpace(world, narrowest, max_slope_deg, cell_m=cell_m, edge_m=_EDGE_M, window=window)
        self._narrowest_m = narrowest
        self.cell_m, self.x, self.y = space.cell_m, space.x, space.y
        self.traversable = space.traversable
        self.clearance: Floats = space.clearance.astype(np.float32)
        apart = np.inf
        if space.steep.any():
            apart = distance_transform_edt(~space.steep, sampling=self.cell_m)
        beside_steep = _STEEP_ROOM * footprint_radius_m + np.asarray(apart, np.float32)
        # Of obstacles and, as in `Routes`, of steep ground.
        self.room: Floats = np.minimum(self.clearance, beside_steep).astype(np.float32)
        slope = world.terrain.slope(np.stack(np.meshgrid(self.x, self.y), axis=-1))
        near = np.clip(1.0 - (space.clearance - footprint_radius_m) / _NEAR_M, 0.0, 1.0)
        spare_m = max(footprint_radius_m - narrowest, 1e-9)
        tight = np.clip((footprint_radius_m - space.clearance) / spare_m, 0, 1)
        steepness = slope / np.deg2rad(max_slope_deg)
        self.cost: Array = 1.0 + _SLOPE_COST * steepness**2 + _NEAR_COST * near * near + _TIGHT_COST * tight

    @cached_property
    def _graph(self) -> csr_matrix:
        """Costs between neighbouring traversable cells, both ways."""
        rows, columns = self.traversable.shape
        number = np.arange(rows * columns).reshape(rows, columns)
        starts, ends, costs = [], [], []
        for down, right in _MOVES:
            length = self.cell_m * float(np.hypot(down, right))
            # A long step also crosses the two cells between its ends.
            halves = {(down // 2, right // 2), (down - down // 2, right - right // 2)}
            halves -= {(0, 0), (down, right)}
            at = _window(rows, columns, down, right, (0, 0))
            to = _window(rows, columns, down, right, (down, right))
            between = [_window(rows, columns, down, right, half) for half in sorted(halves)]
            if down and right and abs(down) == abs(right):
                # Corners are not cut.
                between = [_window(rows, columns, down, right, side) for side in ((down, 0), (0, right))]
            free = self.traversable[at] & self.traversable[to]
            total = self.cost[at] + self.cost[to]
            for cells in between:
                free &= self.traversable[cells]
                total = total + self.cost[cells]
            starts.append(number[at][free])
            ends.append(number[to][free])
            costs.append(length * total[free] / (2 + len(between)))
        one, other, cost = (np.concatenate(parts) for parts in (starts, ends, costs))
        pairs = np.concatenate([one, other]), np.concatenate([other, one])
        return csr_matrix((np.concatenate([cost, cost]), pairs), shape=(number.size, number.size))

    @cached_property
    def _nearest_traversable(self) -> tuple[Array, NDArray[np.int64]]:
        """Distance [m] of each cell from the nearest traversable one, and that cell's number."""
        if not self.traversable.any():
            return np.zeros(self.traversable.shape), np.arange(self.traversable.size)
        apart, (row, column) = distance_transform_edt(
            ~self.traversable, sampling=self.cell_m, return_indices=True
        )
        return apart, (row * self.traversable.shape[1] + column).ravel()

    def cell_number(self, xy: ArrayLike) -> int:
        """Number of the cell of a point (2,) [m], or of the edge's cell nearest to it."""
        x, y = np.asarray(xy, np.float64)
        column = int(np.clip(np.floor((x - self.x[0]) / self.cell_m + 0.5), 0, len(self.x) - 1))
        row = int(np.clip(np.floor((y - self.y[0]) / self.cell_m + 0.5), 0, len(self.y) - 1))
        return row * len(self.x) + column

    def routes_to(self, goal_xy: ArrayLike, start_xy: ArrayLike, blocked: ArrayLike = ()) -> Routes:
        """The cheapest routes to a goal; `blocked` (B, 3: x, y, radius) [m] are discs to avoid besides.

        Costs are exact from where the route costs up to four times the straight distance between both points,
        or from everywhere if the start is farther. Cells that are not traversable lead to the nearest that
        is. Without any route a cell costs 1,000 and its straight distance from the goal, which is its
        waypoint.
        """
        goal, start = np.asarray(goal_xy, np.float64), np.asarray(start_xy, np.float64)
        discs = np.asarray(blocked, np.float64).reshape(-1, 3)
        graph, clearance = self._graph, self.clearance
        for x, y, radius in discs:
            apart = np.hypot(self.x - x, self.y[:, None] - y) - radius
            clearance = np.minimum(clearance, np.maximum(apart, 0.0).astype(np.float32))
        if len(discs):
            # Without the edges at cells that are blocked.
            cells = (clearance < self._narrowest_m).ravel()
            starts = np.repeat(cells, np.diff(graph.indptr))
            lengths = np.where(starts | cells[graph.indices], np.inf, graph.data)
            graph = csr_matrix((lengths, graph.indices, graph.indptr), shape=graph.shape)
        off_m, nearest = self._nearest_traversable
        source = int(nearest[self.cell_number(goal)])
        begin = int(nearest[self.cell_number(start)])
        limit = _REACH * (float(np.hypot(*(goal - start))) + 3.0)
        found, before = dijkstra(graph, indices=source, limit=limit, return_predecessors=True)
        if not np.isfinite(found[begin]):
            found, before = dijkstra(graph, indices=source, return_predecessors=True)
        waypoint = np.where(before < 0, source, before)
        for _ in range(round(np.log2(_WAYPOINT_M / self.cell_m))):
            waypoint = waypoint[waypoint]
        shape = self.traversable.shape
        cost = found[nearest].reshape(shape) + _OFF_COST * off_m
        straight = np.hypot(self.x - goal[0], self.y[:, None] - goal[1])
        return Routes(
            np.where(np.isfinite(cost), cost, _NO_ROUTE_COST + straight).astype(np.float32),
            waypoint[nearest].astype(np.int32).reshape(shape),
            np.minimum(clearance, self.room),
        )


def _window(rows: int, columns: int, down: int, right: int, offset: tuple[int, int]) -> tuple[slice, slice]:
    """The cells at `offset` from those that a step (`down`, `right`) can begin in."""
    first = max(0, -right)
    last_row, last_column = rows - down, columns - max(0, right)
    return (slice(offset[0], last_row + offset[0]), slice(first + offset[1], last_column + offset[1]))


def plan_routes(
    world: World, settings: tuple[float, ...], goal_xy: Array, start_xy: Array, blocked: ArrayLike = ()
) -> tuple[RouteMap, Routes]:
    """The map of a window around a start and a goal (2,), and the cheapest routes to the goal in it.

    `settings` are those of a `RouteMap` after the world; `blocked` is that of `RouteMap.routes_to`. The
    window grows until no way that leaves it can be cheaper than the route within. Cells are 0.1 m where it
    has at most 1,000 m², larger beyond.
    """
    apart_m = float(np.hypot(*(goal_xy - start_xy)))
    margin_m, least = max(MARGIN_M, apart_m), np.inf
    while True:
        window = _window_around(world.extent, goal_xy, start_xy, margin_m)
        known = shared_route_map(world, settings, window)
        routes = known.routes_to(goal_xy, start_xy, blocked)
        cost = float(routes.cost.ravel()[known.cell_number(start_xy)])
        if cost < least:
            least, found = cost, (known, routes)
        if cost <= _shortest_way_out(world.extent, window, goal_xy, start_xy):
            return found
        margin_m *= 3.0


def map_around(world: World, settings: tuple[float, ...], goal_xy: Array, start_xy: Array) -> RouteMap:
    """The shared map of the smallest window around a start and a goal (2,), where cells are the finest."""
    return shared_route_map(world, settings, _window_around(world.extent, goal_xy, start_xy, MARGIN_M))


def _window_around(extent: Window, goal: Array, start: Array, margin_m: float) -> Window:
    """A window with start, goal and a margin, cut off at the world's `extent`."""
    xmin, xmax, ymin, ymax = extent
    origin, end = np.array([xmin, ymin]), np.array([xmax, ymax])
    low = np.floor((np.minimum(goal, start) - margin_m - origin) / _RASTER_M) * _RASTER_M
    high = np.ceil((np.maximum(goal, start) + margin_m - origin) / _RASTER_M) * _RASTER_M
    (left, bottom), (right, top) = np.maximum(origin + low, origin), np.minimum(origin + high, end)
    return float(left), float(right), float(bottom), float(top)


def _shortest_way_out(extent: Window, window: Window, goal: Array, start: Array) -> float:
    """Length [m] of the shortest way from start to goal by the outside of a window; inf if there is none."""
    shortest = np.inf
    for side, (edge, world_edge) in enumerate(zip(window, extent, strict=True)):
        if edge != world_edge:
            axis = side // 2
            across = abs(start[axis] - edge) + abs(goal[axis] - edge)
            shortest = min(shortest, float(np.hypot(across, start[1 - axis] - goal[1 - axis])))
    return shortest


def _cell_of(window: Window) -> float:
    """Width [m] of the cells of a window's map."""
    left, right, bottom, top = window
    area = (right - left) * (top - bottom)
    fine = float(np.clip(np.sqrt(area / _MOST_CELLS), _FINEST_M, _CELL_M))
    return max(fine, float(np.sqrt(area / _MOST_COARSE_CELLS)))


def shared_route_map(world: World, settings: tuple[float, ...], window: Window) -> RouteMap:
    """The route map of a window of a world; the last few are kept with the world."""
    kept: dict[Window, RouteMap] = world.memoize(("route maps", settings), dict)
    known = kept.pop(window, None)
    if known is None:
        known = RouteMap(world, *settings, cell_m=_cell_of(window), window=window)
    kept[window] = known
    if len(kept) > _KEPT_MAPS:
        del kept[next(iter(kept))]
    return known
