"""Tall grass: patches that hide what is in and behind them, hold a robot back, and stop nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.foliage import Foliage
from dune_rl.seeding import stream
from dune_rl.worlds.props import merge_meshes

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mesh = tuple[Array, NDArray[np.int32]]

_CELL_M = 0.25
_MOST_CELLS = 1024
_PATCHES_M = (7.0, 2.5)
# A patch begins thin, and is thick where its noise is this far above the threshold (in deviations).
_THINNEST, _THICKENS_OVER = 0.3, 0.5
# Of full grass. Three leaf areas over each area of ground, at all angles and 0.6 m tall, hide 3 * 0.5 / 0.6
# per metre; a beam, which is wider than a line of sight, still returns from part of it.
_EXTINCTION, _BEAM_EXTINCTION = 2.5, 2.0
# At 0.8 m/s as much as some 15 % of the rover's weight, which is what off-road rolling resistance adds.
_DRAG_NSPM = 20.0
_CLEARED_BELOW_M, _HIGHEST_M = 0.1, 100.0


@dataclass(frozen=True, eq=False)
class Grass:
    """Grass of `height_m` on `terrain`; `density` (rows, columns) is from 0, none, to 1, full.

    The grid's cells share out the terrain's rectangle, the first at its lowest
    x and y. In full grass light is lost by `extinction` and a LiDAR's beams by
    `beam_extinction` [1/m], and a robot that is all in it is held back by
    `drag_nspm` [N s/m] times its velocity.
    """

    terrain: HeightField
    density: Floats
    height_m: float
    extinction: float = _EXTINCTION
    beam_extinction: float = _BEAM_EXTINCTION
    drag_nspm: float = _DRAG_NSPM

    def __post_init__(self) -> None:
        if self.density.ndim != 2 or min(self.density.shape) < 2:
            raise ValueError(f"density must be a grid of at least 2 by 2, not of shape {self.density.shape}")
        if not ((self.density >= 0.0) & (self.density <= 1.0)).all():
            raise ValueError("density must be between 0 and 1")
        if not self.height_m > 0.0:
            raise ValueError(f"height_m must be positive, not {self.height_m}")

    @cached_property
    def foliage(self) -> Foliage:
        """The grass as rays meet it."""
        return Foliage(self.terrain, self.density, self.height_m, self.extinction, self.beam_extinction)

    def drag(self, bottom_w: Array, robot_height_m: float) -> Array:
        """What holds a robot back [N s/m], (M,), whose lowest points are at `bottom_w` (M, 3).

        It is full where the blades reach over all of `robot_height_m`.
        """
        reach = self.terrain.height(bottom_w[:, :2]) + self.height_m - bottom_w[:, 2]
        share = np.clip(reach / robot_height_m, 0.0, 1.0)
        held: Array = self.drag_nspm * self.foliage.density_at(bottom_w) * share
        return held


def grow_grass(
    terrain: HeightField, standing: Sequence[Mesh], cover: float, height_m: float, seed: int
) -> Grass | None:
    """Patches on a `cover` share of the ground, none under or over the meshes in `standing`; None for 0.

    Where these and the world's edge leave less room, grass grows on all there is.
    """
    if cover <= 0.0:
        return None
    xmin, xmax, ymin, ymax = terrain.extent
    columns, rows = (
        int(np.clip(np.ceil(side / _CELL_M), 4, _MOST_CELLS)) for side in (xmax - xmin, ymax - ymin)
    )
    cell_x, cell_y = (xmax - xmin) / columns, (ymax - ymin) / rows
    rng = stream(seed, "grass")
    noise = np.zeros((rows, columns))
    for wavelength, weight in zip(_PATCHES_M, (1.0, 0.5), strict=True):
        sigma = (wavelength / 4 / cell_y, wavelength / 4 / cell_x)
        layer = ndimage.gaussian_filter(rng.standard_normal((rows, columns)), sigma, mode="wrap")
        noise += weight * layer / layer.std()
    free = ~_covered(terrain, standing, rows, columns)
    free[[0, -1]] = free[:, [0, -1]] = False
    count = min(round(cover * rows * columns), int(free.sum()))
    if count == 0:
        return None
    least = np.sort(noise[free])[-count]
    thick = np.clip((noise - least) / (_THICKENS_OVER * noise.std()), 0.0, 1.0)
    density = np.where(free & (noise >= least), _THINNEST + (1.0 - _THINNEST) * thick, 0.0)
    return Grass(terrain, density.astype(np.float32), height_m)


def _covered(terrain: HeightField, standing: Sequence[Mesh], rows: int, columns: int) -> NDArray[np.bool_]:
    """Cells (rows, columns) on or next to which something stands, lies or hangs."""
    covered = np.zeros((rows, columns), bool)
    if not standing:
        return covered
    xmin, xmax, ymin, ymax = terrain.extent
    # Twice as fine as the cells, so that walls do not slip through, and every surface point besides.
    x = xmin + (np.arange(2 * columns) + 0.5) * (xmax - xmin) / (2 * columns)
    y = ymin + (np.arange(2 * rows) + 0.5) * (ymax - ymin) / (2 * rows)
    near = np.zeros((2 * rows, 2 * columns), bool)
    for vertices, _ in standing:
        low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
        (left, right), (bottom, top) = (
            (np.searchsorted(axis, low[k]), np.searchsorted(axis, high[k], side="right"))
            for k, axis in enumerate((x, y))
        )
        near[bottom:top, left:right] = True
    row, column = np.nonzero(near)
    under = np.column_stack([x[column], y[row]])
    origins = np.column_stack([under, terrain.height(under) - _CLEARED_BELOW_M]).astype(np.float32)
    upward = np.zeros_like(origins)
    upward[:, 2] = 1.0
    # As one mesh: hundreds of small ones take a hundred times as long.
    vertices, faces = merge_meshes(standing)
    met = RayScene(vertices, faces).hits(origins, upward, np.full(len(under), _HIGHEST_M, np.float32))
    cell = min((xmax - xmin) / columns, (ymax - ymin) / rows)
    surface, _ = trimesh.remesh.subdivide_to_size(vertices, faces, cell, max_iter=20)
    over = surface[:, 2] > terrain.height(surface[:, :2]) - _CLEARED_BELOW_M
    points = np.concatenate([under[met.face >= 0], surface[over, :2]])
    column = ((points[:, 0] - xmin) * columns / (xmax - xmin)).astype(np.intp)
    row = ((points[:, 1] - ymin) * rows / (ymax - ymin)).astype(np.intp)
    covered[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)] = True
    # Density is interpolated between cells: with their neighbours bare, nothing reaches into these.
    return ndimage.binary_dilation(covered, np.ones((3, 3), bool))
