"""Loops over the points of queries on regular grids, compiled.

Points are (P, 2); `last` (2,) is a grid's last column and row. Points outside a grid get the value of the
nearest point of its edge, and NaN that of the first corner.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function


@compile_function
def _locate(point: Any, origin: Any, inverse_spacing: float, last: Any) -> Any:
    """Column and row of the cell that has `point` (2,), and x and y in it, in [0, 1]."""
    x = min(max((point[0] - origin[0]) * inverse_spacing, 0.0), last[0])
    y = min(max((point[1] - origin[1]) * inverse_spacing, 0.0), last[1])
    # NaN compares false.
    x, y = x if x >= 0.0 else 0.0, y if y >= 0.0 else 0.0
    column, row = min(np.int64(x), np.int64(last[0]) - 1), min(np.int64(y), np.int64(last[1]) - 1)
    return column, row, x - column, y - row


@compile_function
def find_triangles(points: Any, origin: Any, inverse_spacing: float, last: Any, found: Any) -> None:
    """Index `found` (P,) of each point's triangle: two in a cell, the upper left one first, row after row."""
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        found[point] = 2 * (row * np.int64(last[0]) + column) + (1 if x >= y else 0)


@compile_function
def interpolate_triangles(
    points: Any, origin: Any, inverse_spacing: float, last: Any, planes: Any, found: Any
) -> None:
    """Heights `found` (P,), from `planes` (T, 3) of the triangles that `find_triangles` numbers.

    A plane is the height at the lower left corner of its cell, and the rise per cell along x and y.
    """
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        plane = planes[2 * (row * np.int64(last[0]) + column) + (1 if x >= y else 0)]
        found[point] = plane[0] + plane[1] * x + plane[2] * y


@compile_function
def find_and_interpolate_triangles(
    points: Any, origin: Any, inverse_spacing: float, last: Any, planes: Any, triangles: Any, found: Any
) -> None:
    """What `find_triangles` and `interpolate_triangles` find, (P,) each, with one search of each point."""
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        triangle = 2 * (row * np.int64(last[0]) + column) + (1 if x >= y else 0)
        triangles[point] = triangle
        plane = planes[triangle]
        found[point] = plane[0] + plane[1] * x + plane[2] * y


@compile_function
def interpolate_bilinear(
    points: Any, origin: Any, inverse_spacing: float, last: Any, values: Any, found: Any
) -> None:
    """Values `found` (P,), each between four of the grid's `values`, which are row after row."""
    for point in range(len(points)):
        column, row, x, y = _locate(points[point], origin, inverse_spacing, last)
        columns = np.int64(last[0]) + 1
        corner = row * columns + column
        low = values[corner] * (1.0 - x) + values[corner + 1] * x
        high = values[corner + columns] * (1.0 - x) + values[corner + columns + 1] * x
        found[point] = low * (1.0 - y) + high * y
