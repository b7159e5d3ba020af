"""Tall grass as a participating medium above the ground."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import contiguous
from dune_rl.geometry.shared_per_scene import BatchedQueries
from dune_rl.rendering.foliage_marching import TEXELS, march_rays, sample_density

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
