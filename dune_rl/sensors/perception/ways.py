"""The cheapest ways to a goal over a square of cells, of which some are obstacles."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

CELL_M = 0.125
CELLS = 256
# Evidence from which on a cell is an obstacle.
_OCCUPIED = 3.0
# A metre costs 1, and more within so many cells of obstacles, and of low ones, some of which are none.
_AT_CELLS, _BESIDE_CELLS = 2.0, 4.25
_COSTS, _LOW_COSTS = (20.0, 2.0), (6.0, 1.0)
# A metre costs so much more where something has moved: it may come back.
_TRAFFIC_COST = 2.0
# Sweeps go on until no way changes by more than this [m], or for so many rounds.
_LEAST_CHANGE_M, _MOST_ROUNDS = 0.01, 8
_FAR = 1e6


@compile_function
def _raise_around(row: Any, column: Any, added: Any, costs: Any) -> None:
    """Raise the costs around a cell that has an obstacle by those `added` (at it, beside it)."""
    reach = np.int64(_BESIDE_CELLS)
    for y in range(max(row - reach, 0), min(row + reach + 1, CELLS)):
        for x in range(max(column - reach, 0), min(column + reach + 1, CELLS)):
            apart = (y - row) ** 2 + (x - column) ** 2
            if apart <= _BESIDE_CELLS**2:
                costs[y, x] = max(costs[y, x], 1.0 + (added[0] if apart <= _AT_CELLS**2 else added[1]))


@compile_function
def costs_of_cells(evidence: Any, low: Any, traffic: Any, box: Any, costs: Any) -> None:
    """Cost of a metre in each cell of a `box` (as in `solve_ways`), by evidence, low ones and traffic."""
    reach = np.int64(_BESIDE_CELLS)
    for row in range(box[2], box[3]):
        for column in range(box[0], box[1]):
            costs[row, column] = 1.0 + (_TRAFFIC_COST if traffic[row, column] else 0.0)
    for row in range(max(box[2] - reach, 0), min(box[3] + reach, CELLS)):
        for column in range(max(box[0] - reach, 0), min(box[1] + reach, CELLS)):
            if evidence[row, column] >= _OCCUPIED:
                _raise_around(row, column, _COSTS, costs)
            elif low[row, column]:
                _raise_around(row, column, _LOW_COSTS, costs)


@compile_function
def solve_ways(goal_x: float, goal_y: float, costs: Any, ways: Any, box: Any = (0, CELLS, 0, CELLS)) -> None:
    """Cost [m] of the cheapest way from every cell to a goal (column, row), by fast sweeping.

    Zhao (2005), of cells that have nearer neighbours only (Bak et al., 2010).

    A goal outside is reached from the map's edge, straight on. Ways are found within the `box` (first and end
    of its columns, first and end of its rows), and are far from everywhere else.
    """
    left, right, low, high = box
    ways[:] = _FAR
    # Cells whose neighbours have become nearer since they were last looked at, and rows that may have some.
    is_due, due_rows = np.zeros((CELLS, CELLS), np.bool_), np.ones(CELLS, np.bool_)
    column, row = np.int64(np.floor(goal_x)), np.int64(np.floor(goal_y))
    if 0 <= column < CELLS and 0 <= row < CELLS:
        ways[row, column] = 0.0
        is_due[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
    else:
        for edge in range(CELLS):
            for y, x in ((0, edge), (CELLS - 1, edge), (edge, 0), (edge, CELLS - 1)):
                ways[y, x] = CELL_M * np.hypot(x + 0.5 - goal_x, y + 0.5 - goal_y)
        is_due[low:high, left:right] = True
    for _ in range(_MOST_ROUNDS):
        changes = False
        for sweep in range(4):
            for i in range(high - low):
                y = low + i if sweep < 2 else high - 1 - i
                if not due_rows[y]:
                    continue
                due_rows[y] = False
                for j in range(right - left):
                    x = left + j if sweep % 2 == 0 else right - 1 - j
                    if not is_due[y, x]:
                        continue
                    is_due[y, x] = False
                    beside = min(ways[y, max(x - 1, 0)], ways[y, min(x + 1, CELLS - 1)])
                    above = min(ways[max(y - 1, 0), x], ways[min(y + 1, CELLS - 1), x])
                    cost = costs[y, x] * CELL_M
                    if abs(beside - above) >= cost:
                        new = min(beside, above) + cost
                    else:
                        apart = beside - above
                        new = 0.5 * (beside + above + np.sqrt(2.0 * cost * cost - apart * apart))
                    if new < ways[y, x] - _LEAST_CHANGE_M:
                        ways[y, x] = new
                        changes = True
                        is_due[y, max(x - 1, 0)] = is_due[y, min(x + 1, CELLS - 1)] = True
                        is_due[max(y - 1, 0), x] = is_due[min(y + 1, CELLS - 1), x] = True
                        due_rows[max(y - 1, 0) : y + 2] = True
        if not changes:
            break


@compile_function
def box_around(one: float, other: float, margin: int) -> Any:
    """First and end of the columns, or rows, from `one` to `other`, with a margin, as far as there are."""
    first = np.int64(np.floor(min(one, other))) - margin
    end = np.int64(np.floor(max(one, other))) + 1 + margin
    return min(max(first, 0), CELLS - 1), max(min(end, CELLS), 1)


@compile_function
def way_left(ways: Any, origin: Any, x: float, y: float) -> float:
    """Cost of the cheapest way to the goal from a point [m] of the odometry's frame."""
    right = min(max(x / CELL_M - origin[0] - 0.5, 0.0), CELLS - 1.001)
    up = min(max(y / CELL_M - origin[1] - 0.5, 0.0), CELLS - 1.001)
    column, row = np.int64(right), np.int64(up)
    right, up = right - column, up - row
    low = ways[row, column] * (1.0 - right) + ways[row, column + 1] * right
    high = ways[row + 1, column] * (1.0 - right) + ways[row + 1, column + 1] * right
    result: float = low * (1.0 - up) + high * up
    return result
