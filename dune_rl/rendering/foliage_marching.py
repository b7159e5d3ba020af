"""Ray marching through tall grass, compiled."""

from typing import Any

import numpy as np
from numba import njit

# Size of a texel of the tufts' tile [m], and the tile's side in texels (a power of two).
TEXEL_M, TEXELS = 0.02, 512
# Distance over which tufts blend into an even green [m].
_TUFTS_FADE_M = 22.0
# Optical depth after which marching stops: less than 1 % of the light is left.
_OPAQUE = 4.6
# Grass is not visible from farther below the ground than this [m].
_BELOW_GROUND_M = 0.3
# Smallest step above the tips, relative to the step in the grass.
_TIPS_STEP = 0.3
_GOLDEN_RATIO = 0.6180339887498949


@njit(cache=True, nogil=True, error_model="numpy")
def _height(heights: Any, x0: float, y0: float, per_m: float, x: float, y: float) -> float:
    # `HeightField.height` of one point.
    rows, columns = heights.shape
    u = min(max((x - x0) * per_m, 0.0), columns - 1.0)
    v = min(max((y - y0) * per_m, 0.0), rows - 1.0)
    column, row = min(int(u), columns - 2), min(int(v), rows - 2)
    u -= column
    v -= row
    low, high = heights[row, column], heights[row + 1, column + 1]
    if u >= v:
        corner = heights[row, column + 1]
        return low + (corner - low) * u + (high - corner) * v
    corner = heights[row + 1, column]
    return low + (high - corner) * u + (corner - low) * v


@njit(cache=True, nogil=True, error_model="numpy")
def _density(density: Any, x0: float, y0: float, per_x: float, per_y: float, x: float, y: float) -> float:
    rows, columns = density.shape
    u = min(max((x - x0) * per_x - 0.5, 0.0), columns - 1.0)
    v = min(max((y - y0) * per_y - 0.5, 0.0), rows - 1.0)
    column, row = min(int(u), columns - 2), min(int(v), rows - 2)
    u -= column
    v -= row
    low = density[row, column] * (1.0 - u) + density[row, column + 1] * u
    high = density[row + 1, column] * (1.0 - u) + density[row + 1, column + 1] * u
    return low * (1.0 - v) + high * v


@njit(cache=True, nogil=True, error_model="numpy")
def sample_density(cells: Any, points: Any, found: Any) -> None:
    density, _, x0, y0, per_x, per_y = cells
    for k in range(len(points)):
        found[k] = _density(density, x0, y0, per_x, per_y, points[k, 0], points[k, 1])


@njit(cache=True, nogil=True, error_model="numpy")
def _open_way(reach: Any, x0: float, y0: float, per_x: float, per_y: float, x: float, y: float) -> float:
    # Lower bound of the horizontal distance to any grass.
    rows, columns = reach.shape
    column = min(max(int((x - x0) * per_x), 0), columns - 1)
    row = min(max(int((y - y0) * per_y), 0), rows - 1)
    return reach[row, column]


@njit(cache=True, nogil=True, error_model="numpy")
def march_rays(
    ground: Any,
    cells: Any,
    canopy: Any,
    tufts: Any,
    medium: Any,
    origins: Any,
    directions: Any,
    ranges: Any,
    depths: Any,
    crossing: Any,
    found: Any,
) -> None:
    # Marches each ray through the grass. Above the tips and between patches it leaps as far as there can be
    # no grass, given the steepest ground; within grass it advances step by step. Writes the range at which
    # the optical depth reaches `depths` (N,) to `crossing` (N,), and with `detail` > 0 the transmission and
    # the means of distance, height and tint to `found` (4, N).
    heights, ground_x, ground_y, per_m = ground
    density, reach, x0, y0, per_x, per_y = cells
    tall, steepest = canopy
    extinction, least_step, step_share, detail = medium
    per_origin = len(directions) // max(1, len(origins))
    for ray in range(len(directions)):
        ox, oy, oz = origins[ray // per_origin]
        dx, dy, dz = directions[ray]
        if not (abs(ox) + abs(oy) + abs(oz) < 1e7 and abs(dx) + abs(dy) + abs(dz) < 2.0):
            # A ray that is not finite would be looked up outside the grids.
            if detail > 0:
                found[0, ray] = 1.0
            continue
        farthest, target = ranges[ray], depths[ray]
        level = max(np.sqrt(dx * dx + dy * dy), 1e-9)
        closing = steepest * level - dz
        depth, at, passed = 0.0, 0.0, 1.0
        distance_sum, height_sum, tint_sum = 0.0, 0.0, 0.0
        while at < farthest:
            step = least_step + step_share * at
            if detail > 1:
                # Equal steps of neighbouring rays would be visible as bands.
                step *= 0.7 + 0.6 * (ray * _GOLDEN_RATIO % 1.0)
            x, y = ox + dx * at, oy + dy * at
            leap = _open_way(reach, x0, y0, per_x, per_y, x, y) / level
            above = oz + dz * at - _height(heights, ground_x, ground_y, per_m, x, y)
            if above > tall:
                if closing <= 0.0:
                    break
                # The tips are approached in smaller steps than those within the grass.
                at += max(leap, (above - tall) / closing, _TIPS_STEP * step)
                continue
            elif above < -_BELOW_GROUND_M:
                # Outside the world's edge: grass is not visible from below the ground.
                break
            if leap > step:
                at += leap
                continue
            step = min(step, farthest - at)
            share = above / tall
            thick = extinction * _density(density, x0, y0, per_x, per_y, x, y)
            tint, top = 0.0, 1.0
            if detail > 0 and thick > 0.0:
                column, row = int(np.floor(x / TEXEL_M)), int(np.floor(y / TEXEL_M))
                column, row = column & (TEXELS - 1), row & (TEXELS - 1)
                tint = tufts[row, column, 2]
                if detail > 1:
                    near = np.exp(-at / _TUFTS_FADE_M)
                    top = 1.0 + near * (tufts[row, column, 0] - 1.0)
                    thick *= 1.0 + near * (tufts[row, column, 1] - 1.0)
            if thick > 0.0 and share < top:
                more = thick * step
                if depth < target <= depth + more:
                    crossing[ray] = at + (target - depth) / thick
                    if detail == 0:
                        break
                if detail > 0:
                    seen = passed * (1.0 - np.exp(-more))
                    passed -= seen
                    distance_sum += seen * (at + 0.5 * step)
                    height_sum += seen * share / top
                    tint_sum += seen * tint
                depth += more
                if depth > _OPAQUE and depth > target:
                    break
            at += step
        if detail > 0:
            found[0, ray] = passed
            hidden = max(1.0 - passed, 1e-6)
            found[1, ray] = distance_sum / hidden
            found[2, ray] = height_sum / hidden
            found[3, ray] = tint_sum / hidden
