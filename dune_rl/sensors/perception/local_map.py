"""Maps of what LiDARs have seen around moving bodies, by which ways to their goals are found."""

from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.sensors.perception.ways import (
    CELL_M,
    CELLS,
    box_around,
    costs_of_cells,
    solve_ways,
)

# The map moves along when the body is this many cells from its middle.
_ROOM = 64
# Returns from farther are not entered, since a segment is wide there.
_FARTHEST_M = 5.0
# Evidence of an obstacle in a cell: by a return, by a beam that passes, at most.
_HIT, _PASS, _MOST = 2.0, 0.4, 20.0
# That of what the body has met, which no beam takes back.
_MET = 100.0
# Something that has moved was within so many cells of its middle.
_TRAFFIC_CELLS = 3.2
# Low obstacles this near to the body are no longer there if they are not seen again [m].
_CLEARED_M = 3.0
# Ground that is no obstacle, though a scan met it, has no step and so many known cells beside it, of 8.
_GROUND_CELLS = 5
_REPLAN_STEPS = 10


@compile_function
def _recentre(pose: Any, origin: Any, evidence: Any, low: Any, traffic: Any) -> bool:
    """Move a map's layers (CELLS, CELLS) along if the body is far from their middle; whether they moved."""
    column = np.int64(np.floor(pose[0] / CELL_M)) - CELLS // 2
    row = np.int64(np.floor(pose[1] / CELL_M)) - CELLS // 2
    right, up = column - origin[0], row - origin[1]
    if abs(right) <= _ROOM and abs(up) <= _ROOM:
        return False
    old, old_low, old_traffic = evidence.copy(), low.copy(), traffic.copy()
    evidence[:] = 0.0
    low[:] = False
    traffic[:] = False
    for y in range(max(0, -up), min(CELLS, CELLS - up)):
        for x in range(max(0, -right), min(CELLS, CELLS - right)):
            evidence[y, x] = old[y + up, x + right]
            low[y, x] = old_low[y + up, x + right]
            traffic[y, x] = old_traffic[y + up, x + right]
    origin[0], origin[1] = column, row
    return True


@compile_function
def _enter_scan(
    pose: Any, mount: Any, bearings: Any, ranges: Any, rests: Any, moves: Any, origin: Any, evidence: Any
) -> None:
    """Enter a scan of S segments into a map."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x = pose[0] + cos * mount[0] - sin * mount[1]
    y = pose[1] + sin * mount[0] + cos * mount[1]
    for segment in range(len(ranges)):
        along_x, along_y = np.cos(pose[2] + bearings[segment]), np.sin(pose[2] + bearings[segment])
        free = min(ranges[segment], _FARTHEST_M) - 1.2 * CELL_M
        step = 0.5 * CELL_M
        while step < free:
            column = np.int64(np.floor((x + step * along_x) / CELL_M)) - origin[0]
            row = np.int64(np.floor((y + step * along_y) / CELL_M)) - origin[1]
            if 0 <= column < CELLS and 0 <= row < CELLS and evidence[row, column] <= _MOST:
                evidence[row, column] = max(evidence[row, column] - _PASS, 0.0)
            step += CELL_M
        if rests[segment] and not moves[segment] and ranges[segment] < _FARTHEST_M:
            column = np.int64(np.floor((x + ranges[segment] * along_x) / CELL_M)) - origin[0]
            row = np.int64(np.floor((y + ranges[segment] * along_y) / CELL_M)) - origin[1]
            if 0 <= column < CELLS and 0 <= row < CELLS:
                evidence[row, column] = max(evidence[row, column], min(evidence[row, column] + _HIT, _MOST))


@compile_function
def _enter_movers(pose: Any, movers: Any, origin: Any, traffic: Any) -> None:
    """Enter where `movers` (T, 4: x, y [m], velocity [m/s]) are, in the body's frame, into a map.

    `traffic` (CELLS, CELLS) is true where they have been.
    """
    cos, sin, reach = np.cos(pose[2]), np.sin(pose[2]), np.int64(_TRAFFIC_CELLS)
    for mover in range(len(movers)):
        ahead, left = movers[mover, 0], movers[mover, 1]
        column = np.int64(np.floor((pose[0] + cos * ahead - sin * left) / CELL_M)) - origin[0]
        row = np.int64(np.floor((pose[1] + sin * ahead + cos * left) / CELL_M)) - origin[1]
        for y in range(max(row - reach, 0), min(row + reach + 1, CELLS)):
            for x in range(max(column - reach, 0), min(column + reach + 1, CELLS)):
                if (y - row) ** 2 + (x - column) ** 2 <= _TRAFFIC_CELLS**2:
                    traffic[y, x] = True


@compile_function
def _is_ground(y: int, x: int, steps: Any, places: Any) -> bool:
    """Whether a cell of a map of low obstacles, a torus, is amid known ones without a step."""
    size, known = len(steps), -1
    for up in range(-1, 2):
        for right in range(-1, 2):
            other, beside = (y + up) % size, (x + right) % size
            if places[other, beside, 0] - places[y, x, 0] != right:
                continue
            if places[other, beside, 1] - places[y, x, 1] != up:
                continue
            if steps[other, beside]:
                return False
            known += 1
    return known >= _GROUND_CELLS


@compile_function
def _enter_low(
    pose: Any, steps: Any, places: Any, cell_m: float, origin: Any, evidence: Any, low: Any
) -> None:  # fmt: skip
    """Enter a map of low obstacles, as in `update_maps`, into the layer `low` (CELLS, CELLS).

    Cells near the body without one are cleared first, also of what scans have met if they are ground; farther
    ones may be covered by the map in part.
    """
    for is_step in (False, True):
        for y in range(len(steps)):
            for x in range(len(steps)):
                if steps[y, x] != is_step:
                    continue
                at_x, at_y = (places[y, x, 0] + 0.5) * cell_m, (places[y, x, 1] + 0.5) * cell_m
                if not is_step and max(abs(at_x - pose[0]), abs(at_y - pose[1])) > _CLEARED_M:
                    continue
                column = np.int64(np.floor(at_x / CELL_M)) - origin[0]
                row = np.int64(np.floor(at_y / CELL_M)) - origin[1]
                if not (0 <= row < CELLS and 0 <= column < CELLS):
                    continue
                low[row, column] = is_step
                is_met = evidence[row, column] > _MOST
                if not is_step and not is_met and _is_ground(y, x, steps, places):
                    evidence[row, column] = 0.0


@compile_function
def update_maps(
    poses: Any, mount: Any, bearings: Any, ranges: Any, sees: Any, moves: Any, goals: Any, origins: Any,
    evidence: Any, low: Any, traffic: Any, ways: Any, planned: Any, ages: Any, margin: int, movers: Any,
    mover_counts: Any, steps: Any, places: Any, cell_m: float,
) -> None:  # fmt: skip
    """Enter a scan into each row's map, and find the ways anew every 0.5 s, or where the goal has moved.

    They are found in a rectangle with the body and the goal, and `margin` cells around these. Low obstacles
    are where `steps` (N, C, C) tells, in the cells number `places` (N, C, C, 2) of `cell_m` [m]; the layers
    `low` (N, CELLS, CELLS) keep them. `traffic` (N, CELLS, CELLS) is where any of the `movers` (N, T, 4),
    `mover_counts` (N,) of them in a row, have been.
    """
    costs = np.empty((CELLS, CELLS))
    for row in range(len(poses)):
        pose, origin = poses[row], origins[row]
        moved = _recentre(pose, origin, evidence[row], low[row], traffic[row])
        _enter_scan(pose, mount, bearings, ranges[row], sees[row], moves[row], origin, evidence[row])
        _enter_movers(pose, movers[row, : mover_counts[row]], origin, traffic[row])
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        goal_x = pose[0] + cos * goals[row, 0] - sin * goals[row, 1]
        goal_y = pose[1] + sin * goals[row, 0] + cos * goals[row, 1]
        apart = np.hypot(goal_x - planned[row, 0], goal_y - planned[row, 1])
        ages[row] += 1
        if moved or not apart < 0.5 or ages[row] >= _REPLAN_STEPS:
            _enter_low(pose, steps[row], places[row], cell_m, origin, evidence[row], low[row])
            x, y = pose[0] / CELL_M - origin[0], pose[1] / CELL_M - origin[1]
            to_x, to_y = goal_x / CELL_M - origin[0], goal_y / CELL_M - origin[1]
            box = (*box_around(x, to_x, margin), *box_around(y, to_y, margin))
            costs_of_cells(evidence[row], low[row], traffic[row], box, costs)
            solve_ways(to_x, to_y, costs, ways[row], box)
            planned[row, 0], planned[row, 1] = goal_x, goal_y
            ages[row] = 0


def no_low_obstacles(num_rows: int) -> tuple[Flags, Any, float]:
    """What `LowObstacles.map` gives, where nothing is known of low obstacles."""
    return np.zeros((num_rows, 0, 0), bool), np.zeros((num_rows, 0, 0, 2), np.int32), CELL_M


class LocalMap:
    """Maps (N, cells, cells) of 32 by 32 m that move along with N bodies, in the frames of their odometry.

    A cell is an obstacle after two returns. Beams that pass through a cell clear it, the sooner the fewer
    returns it had; not where the body has met something (`block`). Low obstacles, which no scan sees, are a
    layer of their own; where that knows ground without one, returns are no obstacle. Returns from moving
    objects are ignored, but ways through where `movers` have been cost more, until the episode ends. `ways`
    are the costs to the goals [m], found up to `margin` cells from the body and its goal; `origins` (N, 2)
    are the numbers of the maps' first columns and rows.
    """

    def __init__(self, num_rows: int, bearings: Array, mount: Array, margin: int = CELLS) -> None:
        self._margin = margin
        self._bearings, self._mount = np.ascontiguousarray(bearings), np.ascontiguousarray(mount)
        self._evidence = np.zeros((num_rows, CELLS, CELLS), np.float32)
        self._low, self._traffic = np.zeros((2, num_rows, CELLS, CELLS), bool)
        self.ways = np.zeros((num_rows, CELLS, CELLS), np.float32)
        self.origins = np.full((num_rows, 2), -(CELLS // 2), np.int64)
        self._planned = np.full((num_rows, 2), np.nan)
        self._ages = np.zeros(num_rows, np.int64)

    def forget(self, mask: Flags) -> None:
        """Empty the maps of the rows in `mask` (N,), whose odometry begins anew."""
        self._evidence[mask] = 0.0
        self._low[mask] = self._traffic[mask] = False
        self.origins[mask] = -(CELLS // 2)
        self._planned[mask] = np.nan
        self._ages[mask] = 0

    def block(self, row: int, disc: Array) -> None:
        """Enter a disc (3,: x, y, radius) [m] that the body of a row has met."""
        column, line = np.floor(disc[:2] / CELL_M).astype(int) - self.origins[row]
        if 0 <= column < CELLS and 0 <= line < CELLS:
            reach = int(disc[2] / CELL_M)
            across, along = np.ogrid[-reach : reach + 1, -reach : reach + 1]
            there = np.argwhere(across**2 + along**2 <= reach**2) - reach + (line, column)
            there = there[((there >= 0) & (there < CELLS)).all(axis=1)]
            self._evidence[row, there[:, 0], there[:, 1]] = _MET
            self._planned[row] = np.nan

    def update(
        self, poses: Array, ranges: Array, sees: Flags, moves: Flags, goals: Array,
        low: tuple[Flags, Any, float] | None = None, movers: tuple[Array, Any] | None = None,
    ) -> None:  # fmt: skip
        """Take a scan: `ranges` (N, S) [m], which segments have a return and which of them move (N, S), at
        `poses` (N, 3) of the odometry; `goals` (N, 2) [m] are in the vehicles' frames. `low` is as
        `LowObstacles.map` gives it. `movers` are what moves (N, T, 4: x, y, velocity), in the vehicles'
        frames, and how many there are in a row (N,).
        """
        moving, counts = movers or (np.zeros((len(poses), 0, 4)), np.zeros(len(poses), np.int64))
        update_maps(
            poses, self._mount, self._bearings, ranges, sees, moves, goals, self.origins, self._evidence,
            self._low, self._traffic, self.ways, self._planned, self._ages, self._margin, moving, counts,
            *(low or no_low_obstacles(len(poses))),
        )  # fmt: skip
