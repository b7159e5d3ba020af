"""Tall grass as rays meet it: a thin medium over the ground, in which they are lost by and by."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import DerivedCache, SharedPerScene

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

# Steps along a ray: metres close by, and how much of the range more. What beams need, what small pictures do,
# whose pixels show the more the farther they look, and what tells single tufts in large ones.
_BEAM_STEP, _PIXEL_STEP, _TUFT_STEP = (0.1, 0.0), (0.15, 0.03), (0.02, 0.003)
# Tufts: a tile repeated over the ground, and where they blur to an even green.
_TEXEL_M, _TEXELS = 0.02, 512
_TUFTS_FADE_M = 22.0
_MEDIAN = float(np.log(2.0))
# Of optical depth: what is left of the light, less than a hundredth, would not show.
_OPAQUE = 4.6
_UNDER_M, _CLOSELY = 0.3, 0.3
_GOLDEN = 0.6180339887498949


class FoliageTransmission(NamedTuple):
    """What grass does to rays (N,): the share of light that passes, and what is seen instead of the rest.

    `range` [m] is where half of the light is lost, inf where less is. Means over
    what is seen are `distance` [m], `height`, from the ground (0) to the tips
    (1), and `tint`, from fresh (0) to dry (1).
    """

    passed: Floats
    range: Floats
    distance: Floats
    height: Floats
    tint: Floats


class Foliage:
    """Grass of `height_m` over `terrain`, with a `density` (rows, columns) from 0 to 1.

    The grid's cells share out the terrain's rectangle, the first at its lowest x
    and y; between their centres density is interpolated, and beyond the edge it is
    that of the edge. Light is lost by Beer and Lambert's law, as in any canopy of
    small leaves (Monsi and Saeki, 1953): `extinction` [1/m] times the density per
    metre of path, and `beam_extinction` for a LiDAR's beams.
    """

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
        steepest = float(terrain.normal(_middles(terrain))[..., 2].min())
        # From anywhere in a cell, so far at least to where interpolated density is above 0.
        away = ndimage.distance_transform_edt(density <= 0.0, sampling=(cell_y, cell_x))
        if not (density > 0.0).any():
            away = np.full(density.shape, np.inf)
        reach = np.maximum(away - 1.5 * np.hypot(cell_x, cell_y), 0.0).astype(np.float32)
        self._ground = (terrain.heights, *terrain.origin, 1.0 / terrain.spacing_m)
        self._cells = (self._density, reach, xmin, ymin, 1.0 / cell_x, 1.0 / cell_y)
        self._canopy = (height_m, float(np.sqrt(1.0 / steepest**2 - 1.0)))

    def density_at(self, points: Array) -> Array:
        """Density (N,) at points (N, 2 or 3)."""
        found = np.empty(len(points))
        _densities(self._cells, np.ascontiguousarray(points[:, :2], np.float64), found)
        return found

    def beam_ranges(self, origins: Floats, directions: Floats, ranges: Floats, depths: Floats) -> Floats:
        """Where beams of `ranges` (N,) [m] have passed optical `depths` (N,), inf where they have not.

        `origins` (S, 3) and unit `directions` (N, 3) are as for a `RayScene`.
        With depths of -ln(u), u evenly in (0, 1), that is where each meets its first blade.
        """
        return self._marched(origins, directions, ranges, depths, self._beam_extinction, _BEAM_STEP, 0)[0]

    def median_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> Floats:
        """Where rays of `ranges` (N,) [m] have lost half their light, inf where they have not."""
        depths = np.full(len(directions), _MEDIAN, np.float32)
        return self._marched(origins, directions, ranges, depths, self.extinction, _BEAM_STEP, 0)[0]

    def transmission(self, origins: Floats, directions: Floats, ranges: Floats, *, tufts: bool = False) -> FoliageTransmission:
        """What lies before rays of `ranges` (N,) [m]; `tufts` tells single ones near by apart."""
        depths = np.full(len(directions), _MEDIAN, np.float32)
        step, detail = (_TUFT_STEP, 2) if tufts else (_PIXEL_STEP, 1)
        crossing, found = self._marched(origins, directions, ranges, depths, self.extinction, step, detail)
        return FoliageTransmission(found[0], crossing, *found[1:])

    def shade(self, points: Array) -> Floats:
        """Share (N,) of daylight that reaches the ground at points (N, 2 or 3)."""
        share: Floats = np.exp(-self.extinction * self.height_m * self.density_at(points)).astype(np.float32)
        return share

    def _marched(
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
        found = np.zeros((4, len(directions) if detail else 0), np.float32)
        _march(
            self._ground,
            self._cells,
            self._canopy,
            _tufts(),
            (extinction, *step, detail),
            _plain(origins),
            _plain(directions),
            _plain(ranges),
            _plain(depths),
            crossing,
            found,
        )
        return crossing, found


class BatchedFoliage:
    """Grass as the beams of M scenes meet it, of which each may have its own, or None.

    Origins (S, 3) and rays (N, 3) are those of all scenes, scene after scene.
    """

    def __init__(self, foliages: SharedPerScene[Foliage | None] | DerivedCache[Any, Foliage | None]) -> None:
        self._foliages = foliages

    @property
    def none(self) -> bool:
        """Whether no scene has any."""
        return all(foliage is None for foliage, _ in self._foliages.groups)

    def beam_ranges(self, origins: Floats, directions: Floats, ranges: Floats, depths: Floats) -> Floats:
        """As `Foliage.beam_ranges`."""
        return self._each(Foliage.beam_ranges, origins, directions, ranges, depths)

    def median_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> Floats:
        """As `Foliage.median_ranges`."""
        return self._each(Foliage.median_ranges, origins, directions, ranges)

    def _each(self, ask: Callable[..., Floats], *rays: Floats) -> Floats:
        groups = self._foliages.groups
        if len(groups) == 1 and groups[0][0] is not None:
            return ask(groups[0][0], *rays)
        by_scene = [part.reshape(len(self._foliages), -1, *part.shape[1:]) for part in rays]
        count = len(rays[1]) // len(self._foliages)
        found = np.full((len(self._foliages), count), np.inf, np.float32)
        for foliage, rows in groups:
            if foliage is not None:
                parts = [part[rows].reshape(-1, *part.shape[2:]) for part in by_scene]
                found[rows] = ask(foliage, *parts).reshape(-1, count)
        return found.ravel()


@lru_cache(maxsize=1)
def _tufts() -> Floats:
    """Relative height, relative density and tint (rows, columns, 3) of columns of grass; it repeats."""
    draws = np.random.default_rng(11).standard_normal((3, _TEXELS, _TEXELS))

    def noise(layer: int, *sigmas: float) -> Array:
        total = sum(ndimage.gaussian_filter(draws[layer], sigma, mode="wrap") * sigma for sigma in sigmas)
        unit: Array = total / np.std(total)
        return unit

    clumps = noise(0, 5.0, 14.0)
    tall = np.clip(0.74 + 0.12 * clumps + 0.13 * noise(1, 0.7), 0.3, 1.0)
    dense = np.clip(1.0 + 0.9 * noise(2, 0.7, 1.5) + 0.4 * clumps, 0.05, None)
    tint = 0.42 + 0.12 * noise(0, 30.0, 70.0) + 0.12 * clumps + 0.2 * noise(1, 0.7)
    return np.stack([tall, dense / (dense * tall).mean(), tint], axis=-1).astype(np.float32)


def _plain(values: Floats) -> Floats:
    # Of one layout, so that one compiled function serves all.
    values = np.ascontiguousarray(values, np.float32)
    return values if values.flags.writeable else values.copy()


def _middles(terrain: HeightField) -> Array:
    """Points (T, 2), one in the middle of each of the terrain's triangles."""
    vertices, faces = terrain.mesh()
    middles: Array = vertices[faces, :2].mean(axis=1)
    return middles


@njit(cache=True, nogil=True, error_model="numpy")
def _height(heights: Any, x0: float, y0: float, per_m: float, x: float, y: float) -> float:
    # As `HeightField.height`, for one point.
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
def _densities(cells: Any, points: Any, found: Any) -> None:
    density, _, x0, y0, per_x, per_y = cells
    for k in range(len(points)):
        found[k] = _density(density, x0, y0, per_x, per_y, points[k, 0], points[k, 1])


@njit(cache=True, nogil=True, error_model="numpy")
def _open_way(reach: Any, x0: float, y0: float, per_x: float, per_y: float, x: float, y: float) -> float:
    # How far it is at least to any grass, seen from above.
    rows, columns = reach.shape
    column = min(max(int((x - x0) * per_x), 0), columns - 1)
    row = min(max(int((y - y0) * per_y), 0), rows - 1)
    return reach[row, column]


@njit(cache=True, nogil=True, error_model="numpy")
def _march(
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
    # Rays through the grass, one by one. Over the tips and between patches they leap as far as they
    # cannot meet any, however steep the ground; in it they go step by step.
    heights, ground_x, ground_y, per_m = ground
    density, reach, x0, y0, per_x, per_y = cells
    tall, steepest = canopy
    extinction, least_step, step_share, detail = medium
    per_origin = len(directions) // max(1, len(origins))
    for ray in range(len(directions)):
        ox, oy, oz = origins[ray // per_origin]
        dx, dy, dz = directions[ray]
        if not (abs(ox) + abs(oy) + abs(oz) < 1e7 and abs(dx) + abs(dy) + abs(dz) < 2.0):
            # A ray from or to nowhere would be looked up outside the grids.
            if detail > 0:
                found[0, ray] = 1.0
            continue
        farthest, wanted = ranges[ray], depths[ray]
        level = max(np.sqrt(dx * dx + dy * dy), 1e-9)
        closing = steepest * level - dz
        depth, at, passed = 0.0, 0.0, 1.0
        distance_sum, height_sum, tint_sum = 0.0, 0.0, 0.0
        while at < farthest:
            step = least_step + step_share * at
            if detail > 1:
                # Rays side by side that step alike would show it as bands.
                step *= 0.7 + 0.6 * (ray * _GOLDEN % 1.0)
            x, y = ox + dx * at, oy + dy * at
            leap = _open_way(reach, x0, y0, per_x, per_y, x, y) / level
            above = oz + dz * at - _height(heights, ground_x, ground_y, per_m, x, y)
            if above > tall:
                if closing <= 0.0:
                    break
                # The tips are looked for more closely than what is among them.
                at += max(leap, (above - tall) / closing, _CLOSELY * step)
                continue
            elif above < -_UNDER_M:
                # Beside the world, past its edge: grass is not seen from below the ground.
                break
            if leap > step:
                at += leap
                continue
            step = min(step, farthest - at)
            share = above / tall
            thick = extinction * _density(density, x0, y0, per_x, per_y, x, y)
            tint, top = 0.0, 1.0
            if detail > 0 and thick > 0.0:
                column, row = int(np.floor(x / _TEXEL_M)), int(np.floor(y / _TEXEL_M))
                column, row = column & (_TEXELS - 1), row & (_TEXELS - 1)
                tint = tufts[row, column, 2]
                if detail > 1:
                    near = np.exp(-at / _TUFTS_FADE_M)
                    top = 1.0 + near * (tufts[row, column, 0] - 1.0)
                    thick *= 1.0 + near * (tufts[row, column, 1] - 1.0)
            if thick > 0.0 and share < top:
                more = thick * step
                if depth < wanted <= depth + more:
                    crossing[ray] = at + (wanted - depth) / thick
                    if detail == 0:
                        break
                if detail > 0:
                    seen = passed * (1.0 - np.exp(-more))
                    passed -= seen
                    distance_sum += seen * (at + 0.5 * step)
                    height_sum += seen * share / top
                    tint_sum += seen * tint
                depth += more
                if depth > _OPAQUE and depth > wanted:
                    break
            at += step
        if detail > 0:
            found[0, ray] = passed
            hidden = max(1.0 - passed, 1e-6)
            found[1, ray] = distance_sum / hidden
            found[2, ray] = height_sum / hidden
            found[3, ray] = tint_sum / hidden
