"""Which pixels show triangles, and which points triangles hide from the sun: compiled, without rays."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

# What is nearer to the camera's plane is not drawn.
_NEAR_M = 0.001


@compile_function
def rasterise(vertices: Any, faces: Any, focal: float, depths: Any, seen: Any, normals: Any) -> None:
    """Lessen `depths` (height, width) [m] to the first of `faces` (F, 3) that each pixel shows, and write its
    number to `seen` (height, width).

    `vertices` (V, 3) [m] are in the frame of the camera, to the right, down and ahead; `focal` [px] is its
    focal length. The `normals` (F, 3) of faces that may be seen are written, not normalised.
    """
    height, width = depths.shape
    middle_x, middle_y = 0.5 * width, 0.5 * height
    for number in range(len(faces)):
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for k in range(3):
            a, b = faces[number, k], faces[number, (k + 1) % 3]
            x, y, z, step = vertices[a, 0], vertices[a, 1], vertices[a, 2], vertices[b, 2] - vertices[a, 2]
            # The corner, and where the edge from it passes the plane.
            for share in (0.0, (_NEAR_M - z) / step if step != 0.0 else 0.0):
                if not (0.0 < share < 1.0 or (share == 0.0 and z > _NEAR_M)):
                    continue
                per_m = focal / max(z + share * step, _NEAR_M)
                column = middle_x + per_m * (x + share * (vertices[b, 0] - x))
                row = middle_y + per_m * (y + share * (vertices[b, 1] - y))
                left, right = min(left, column), max(right, column)
                top, bottom = min(top, row), max(bottom, row)
        if right < 0.0 or left >= width or bottom < 0.0 or top >= height or left > right:
            continue
        # After Möller and Trumbore (1997), for rays that begin at the camera.
        a, b, c = faces[number, 0], faces[number, 1], faces[number, 2]
        x0, y0, z0 = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        x1, y1, z1 = vertices[b, 0] - x0, vertices[b, 1] - y0, vertices[b, 2] - z0
        x2, y2, z2 = vertices[c, 0] - x0, vertices[c, 1] - y0, vertices[c, 2] - z0
        xn, yn, zn = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        above = -(x0 * xn + y0 * yn + z0 * zn)
        if above == 0.0:
            continue
        normals[number, 0], normals[number, 1], normals[number, 2] = xn, yn, zn
        # Parts of the face's area as they are seen, and that of all of it, along a ray of a depth of 1 m.
        xw, yw, zw = -xn / above, -yn / above, -zn / above
        xu, yu, zu = (z2 * y0 - y2 * z0) / above, (x2 * z0 - z2 * x0) / above, (y2 * x0 - x2 * y0) / above
        xv, yv, zv = (z0 * y1 - y0 * z1) / above, (x0 * z1 - z0 * x1) / above, (y0 * x1 - x0 * y1) / above
        for row in range(max(0, int(top)), min(height, int(bottom) + 1)):
            y = (row + 0.5 - middle_y) / focal
            u0, v0, w0 = y * yu + zu, y * yv + zv, y * yw + zw
            for column in range(max(0, int(left)), min(width, int(right) + 1)):
                x = (column + 0.5 - middle_x) / focal
                u, v, whole = x * xu + u0, x * xv + v0, x * xw + w0
                if u >= 0.0 and v >= 0.0 and u + v <= whole and depths[row, column] * whole > 1.0:
                    depths[row, column] = 1.0 / whole
                    seen[row, column] = number


@compile_function
def mark_hidden(points: Any, first: Any, width: int, vertices: Any, faces: Any, hidden: Any) -> None:
    """Mark in `hidden` (K,) those of `points` (K, 3) that one of `faces` (F, 3) hides from above.

    Points and `vertices` (V, 3) have a column and a row, as fractions, and a height [cells]. Points are
    sorted by their cell of a grid of `width` columns, row by row; `first` (cells + 1,) has the number of the
    first point of each cell, and that of points.
    """
    height = (len(first) - 1) // width
    for number in range(len(faces)):
        a, b, c = faces[number, 0], faces[number, 1], faces[number, 2]
        x0, y0, z0 = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        x1, y1, z1 = vertices[b, 0] - x0, vertices[b, 1] - y0, vertices[b, 2] - z0
        x2, y2, z2 = vertices[c, 0] - x0, vertices[c, 1] - y0, vertices[c, 2] - z0
        left, right = max(0, int(x0 + min(0.0, x1, x2))), min(width, int(x0 + max(0.0, x1, x2)) + 1)
        top, bottom = max(0, int(y0 + min(0.0, y1, y2))), min(height, int(y0 + max(0.0, y1, y2)) + 1)
        area = x1 * y2 - y1 * x2
        if left >= right or area == 0.0:
            continue
        x1, y1, x2, y2 = x1 / area, y1 / area, x2 / area, y2 / area
        for row in range(top, bottom):
            for k in range(first[row * width + left], first[row * width + right]):
                if hidden[k]:
                    continue
                x, y = points[k, 0] - x0, points[k, 1] - y0
                u, v = x * y2 - y * x2, x1 * y - y1 * x
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and z0 + u * z1 + v * z2 > points[k, 2]:
                    hidden[k] = True
