"""Loops over the pixels of large pictures: the ground and the props that they show."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

# Noise finer than the ground's texture: a tile repeated over the ground.
GRAIN_TILE_M, GRAIN_TEXELS = 2.56, 512
_GRAIN_STRENGTH, _GRAIN_FADES_M = 0.16, 14.0


@compile_function
def _weigh(grid: Any, at: Any, corner: Any, per_m: Any, weights: Any) -> tuple[int, int]:
    """Row and column of the texel below a point `at`, and shares `weights` (4,) of it and its neighbours."""
    rows, columns = grid.shape[0], grid.shape[1]
    row = (at[1] - corner[1]) * per_m[1] * np.float32(rows) - np.float32(0.5)
    column = (at[0] - corner[0]) * per_m[0] * np.float32(columns) - np.float32(0.5)
    row = min(max(row, np.float32(0.0)), np.float32(rows - 1))
    column = min(max(column, np.float32(0.0)), np.float32(columns - 1))
    top, left = min(int(row), rows - 2), min(int(column), columns - 2)
    v, u = row - np.float32(top), column - np.float32(left)
    weights[0], weights[1] = (1 - v) * (1 - u), (1 - v) * u
    weights[2], weights[3] = v * (1 - u), v * u
    return top, left


@compile_function
def _mix(grid: Any, top: int, left: int, weights: Any, found: Any) -> None:
    """Fill `found` (3,) with the mean of four texels of `grid` (R, C, 3) by their `weights`."""
    for axis in range(3):
        upper = grid[top, left, axis] * weights[0] + grid[top, left + 1, axis] * weights[1]
        lower = grid[top + 1, left, axis] * weights[2] + grid[top + 1, left + 1, axis] * weights[3]
        found[axis] = upper + lower


@compile_function
def sample_ground(
    points: Any,
    chosen: Any,
    corner: Any,
    per_m: Any,
    colours: Any,
    slopes: Any,
    shares: Any,
    albedo: Any,
    normals: Any,
    sky_share: Any,
) -> None:
    """Fill `albedo` (N, 3), `normals` (N, 3) and `sky_share` (N,) at the `chosen` ones of points (N, 3).

    `colours` (R, C, 3), `slopes` (R, C, 3; unit normals) and `shares` (R, C) are grids over the ground, which
    begins at `corner` (2,) [m] and has `per_m` (2,) parts of its sides in a metre.
    """
    weights = np.empty(4, np.float32)
    for k in chosen:
        top, left = _weigh(colours, points[k], corner, per_m, weights)
        _mix(colours, top, left, weights, albedo[k])
        top, left = _weigh(slopes, points[k], corner, per_m, weights)
        _mix(slopes, top, left, weights, normals[k])
        top, left = _weigh(shares, points[k], corner, per_m, weights)
        upper = shares[top, left] * weights[0] + shares[top, left + 1] * weights[1]
        sky_share[k] = upper + shares[top + 1, left] * weights[2] + shares[top + 1, left + 1] * weights[3]


@compile_function
def add_grain(points: Any, ranges: Any, chosen: Any, grain: Any, share: float, albedo: Any) -> None:
    """Vary the brightness of `albedo` (N, 3) at the `chosen` ones of points (N, 3), `ranges` (N,) away.

    The noise of `grain` (texels squared,) fades out where it would flicker.
    """
    per_m = np.float32(GRAIN_TEXELS / GRAIN_TILE_M)
    for k in chosen:
        # Sheared, so that vertical walls have noise, too.
        slant = points[k, 2] * np.float32(0.71)
        column = int((points[k, 0] + slant) * per_m) & (GRAIN_TEXELS - 1)
        row = int((points[k, 1] + slant) * per_m) & (GRAIN_TEXELS - 1)
        fade = np.float32(_GRAIN_STRENGTH * share) * np.exp(ranges[k] * np.float32(-1.0 / _GRAIN_FADES_M))
        bright = np.float32(1.0) + grain[row * GRAIN_TEXELS + column] * fade
        for axis in range(3):
            albedo[k, axis] *= bright


@compile_function
def interpolate_in_faces(points: Any, chosen: Any, faces: Any, corners: Any, values: Any, shown: Any) -> None:
    """Fill `shown` (N,) at the `chosen` ones (K,) of points (N, 3), which are on `faces` (K,).

    The faces have `corners` (F, 3, 3) with `values` (F, 3).
    """
    for place in range(len(chosen)):
        k, face = chosen[place], faces[place]
        uu = uv = vv = up = vp = 0.0
        for axis in range(3):
            first = corners[face, 0, axis]
            u, v = corners[face, 1, axis] - first, corners[face, 2, axis] - first
            p = points[k, axis] - first
            uu, uv, vv, up, vp = uu + u * u, uv + u * v, vv + v * v, up + u * p, vp + v * p
        area = max(uu * vv - uv * uv, 1e-12)
        second = min(max((vv * up - uv * vp) / area, 0.0), 1.0)
        third = min(max((uu * vp - uv * up) / area, 0.0), 1.0 - second)
        shown[k] = (
            values[face, 0] * (1.0 - second - third) + values[face, 1] * second + values[face, 2] * third
        )
