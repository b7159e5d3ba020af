"""Tall grass as a participating medium above the ground."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numba import njit

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import contiguous
from dune_rl.geometry.shared_per_scene import BatchedQueries

# Marching steps: constant part [m], and growth with the distance. For LiDAR beams, for small pictures, whose
# pixels cover more at a distance, and for large pictures, which show single tufts.
_BEAM_STEP, _PIXEL_STEP, _TUFT_STEP = (0.1, 0.0), (0.15, 0.03), (0.02, 0.003)
_MEDIAN_DEPTH = float(np.log(2.0))


class FoliageTransmission(NamedTuple):
    """Transmission of N rays through grass, and the mean properties of the grass that hides the rest.

    `passed` (N,) is the share of light that passes. `range` (N,) [m] is where half of the light is lost, inf
    where less is. Means over the visible grass are `distance` [m], `height`, from the ground (0) to the tips
    (1), and `tint`, from fresh (0) to dry (1).
    """

    passed: Floats
    range: Floats
    distance: Floats
    height: Floats
    tint: Floats


class Foliage:
    """Grass of `height_m` above `terrain`, with a `density` (rows, columns) from 0 to 1.

    The grid's cells divide the terrain's rectangle evenly, the first at its lowest x and y; density is
    interpolated between their centres, and outside it is that of the edge. Light is attenuated by the
    Beer-Lambert law, as in any canopy of small leaves (Monsi and Saeki, 1953), with the coefficient
    `extinction` [1/m] times density, and `beam_extinction` for LiDAR beams.
    """

    # Whether there is no grass at all.
    none = False

    def __init__(
        self,
        terrain: HeightField,
        density: Floats,
        height_m: float,
        extinction: float,
        beam_extinction: float,
    ) -> None:
        self.height_m, self.extinction = height_m, extinction
        self._beam_extinction = beam_extinction
        self._density = np.ascontiguousarray(density, np.float32)
        xmin, xmax, ymin, ymax = terrain.extent
        rows, columns = density.shape
        cell_x, cell_y = (xmax - xmin) / columns, (ymax - ymin) / rows
        vertices, faces = terrain.mesh()
        steepest = float(terrain.normal(vertices[faces, :2].mean(axis=1))[..., 2].min())
        # From anywhere in a cell, a lower bound of the distance to interpolated density above 0.
        away = scipy.ndimage.distance_transform_edt(density <= 0.0, sampling=(cell_y, cell_x))
        if not (density > 0.0).any():
            away = np.full(density.shape, np.inf)
        reach = np.maximum(away - 1.5 * np.hypot(cell_x, cell_y), 0.0).astype(np.float32)
        self._ground = (terrain.heights, *terrain.origin, 1.0 / terrain.spacing_m)
        self._cells = (self._density, reach, xmin, ymin, 1.0 / cell_x, 1.0 / cell_y)
        self._canopy = (height_m, float(np.sqrt(1.0 / steepest**2 - 1.0)))

    def density_at(self, points: Array) -> Array:
        """Density (N,) at points (N, 2 or 3)."""
        density = np.empty(len(points))
        sample_density(self._cells, np.ascontiguousarray(points[:, :2], np.float64), density)
        return density

    def beam_ranges(self, origins: Floats, directions: Floats, ranges: Floats, depths: Floats) -> Floats:
        """Ranges (N,) [m] at which beams reach optical `depths` (N,), inf where not within `ranges` (N,).

        `origins` (S, 3) and unit `directions` (N, 3) are as for a `RayScene`.
        For depths of -ln(u), u uniform in (0, 1), these are random ranges of the first blade hit.
        """
        return self._march(origins, directions, ranges, depths, self._beam_extinction, _BEAM_STEP, 0)[0]

    def median_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> Floats:
        """Ranges (N,) [m] at which rays have lost half their light, inf where not within `ranges` (N,)."""
        depths = np.full(len(directions), _MEDIAN_DEPTH, np.float32)
        return self._march(origins, directions, ranges, depths, self.extinction, _BEAM_STEP, 0)[0]

    def transmission(
        self, origins: Floats, directions: Floats, ranges: Floats, *, tufts: bool = False
    ) -> FoliageTransmission:
        """Transmission of rays of `ranges` (N,) [m]; with `tufts`, single tufts are visible nearby."""
        depths = np.full(len(directions), _MEDIAN_DEPTH, np.float32)
        step, detail = (_TUFT_STEP, 2) if tufts else (_PIXEL_STEP, 1)
        crossing, means = self._march(origins, directions, ranges, depths, self.extinction, step, detail)
        return FoliageTransmission(means[0], crossing, *means[1:])

    def shade(self, points: Array) -> Floats:
        """Share (N,) of daylight that reaches the ground at points (N, 2 or 3)."""
        return np.exp(-self.extinction * self.height_m * self.density_at(points)).astype(np.float32)

    def _march(
        self,
        origins: Floats,
        directions: Floats,
        ranges: Floats,
        depths: Floats,
        extinction: float,
        step: tuple[float, float],
        detail: int,
    ) -> tuple[Floats, Floats]:
        crossing = np.full(len(directions), np.inf, np.float32)
        means = np.zeros((4, len(directions) if detail else 0), np.float32)
        grass, medium = (self._ground, self._cells, self._canopy, _tufts()), (extinction, *step, detail)
        rays = contiguous(origins), contiguous(directions), contiguous(ranges), contiguous(depths)
        march_rays(*grass, medium, *rays, crossing, means)
        return crossing, means


class BatchedFoliage(BatchedQueries[Foliage | None]):
    """The `Foliage` of each of M scenes, None for a scene without grass; origins and rays are scene-major."""

    @property
    def none(self) -> bool:
        """Whether no scene has grass."""
        return all(foliage is None for foliage, _ in self._items.groups)

    def beam_ranges(self, origins: Floats, directions: Floats, ranges: Floats, depths: Floats) -> Floats:
        """As `Foliage.beam_ranges`."""
        return self._query(_ranges(Foliage.beam_ranges), origins, directions, ranges, depths)[0]

    def median_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> Floats:
        """As `Foliage.median_ranges`."""
        return self._query(_ranges(Foliage.median_ranges), origins, directions, ranges)[0]


def _ranges(query: Callable[..., Floats]) -> Callable[..., tuple[Floats]]:
    def ranges(foliage: Foliage | None, *rays: Floats) -> tuple[Floats]:
        if foliage is None:
            return (np.full(len(rays[1]), np.inf, np.float32),)
        return (query(foliage, *rays),)

    return ranges


@lru_cache(maxsize=1)
def _tufts() -> Floats:
    """Tile of relative height, relative density and tint (rows, columns, 3) of the grass."""
    draws = np.random.default_rng(11).standard_normal((3, TEXELS, TEXELS))

    def noise(layer: int, *sigmas: float) -> Array:
        total = sum(
            scipy.ndimage.gaussian_filter(draws[layer], sigma, mode="wrap") * sigma for sigma in sigmas
        )
        return total / np.std(total)

    clumps = noise(0, 5.0, 14.0)
    tall = np.clip(0.74 + 0.12 * clumps + 0.13 * noise(1, 0.7), 0.3, 1.0)
    dense = np.clip(1.0 + 0.9 * noise(2, 0.7, 1.5) + 0.4 * clumps, 0.05, None)
    tint = 0.42 + 0.12 * noise(0, 30.0, 70.0) + 0.12 * clumps + 0.2 * noise(1, 0.7)
    return np.stack([tall, dense / (dense * tall).mean(), tint], axis=-1).astype(np.float32)


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
