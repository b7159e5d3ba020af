"""Tall grass: patches that occlude cameras and LiDAR beams and slow robots down without blocking them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.foliage import Foliage
from dune_rl.worlds.props import Mesh, merge_meshes

_CELL_M = 0.25
_MOST_CELLS = 1024
_PATCHES_M = (7.0, 2.5)
# Density at a patch's edge, and the noise above the threshold (in standard deviations) where it reaches 1.
_EDGE_DENSITY, _FULL_DENSITY_AT = 0.3, 0.5
# Extinction [1/m] at density 1. A leaf area index of 3 with randomly oriented leaves 0.6 m tall gives
# 3 * 0.5 / 0.6 per metre; a LiDAR beam, wider than a line of sight, still returns from what is behind part.
_EXTINCTION, _BEAM_EXTINCTION = 2.5, 2.0
# At 0.8 m/s about 15 % of the rover's weight, which is what off-road rolling resistance adds.
_DRAG_NSPM = 20.0
_CLEARED_BELOW_M, _HIGHEST_M = 0.1, 100.0


@dataclass(frozen=True, eq=False)
class Grass:
    """Grass of `height_m` on `terrain`; `density` (rows, columns) is from 0 (no grass) to 1.

    The grid's cells divide the terrain's rectangle evenly; the first is at the lowest x and y. At density 1,
    light is attenuated by `extinction` and LiDAR beams by `beam_extinction` [1/m], and a robot whose whole
    height is in the grass is slowed by a drag of `drag_nspm` [N s/m] times its velocity.
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
        """The grass as a medium for rays."""
        return Foliage(self.terrain, self.density, self.height_m, self.extinction, self.beam_extinction)

    def drag(self, bottom_w: Array, robot_height_m: float) -> Array:
        """Drag coefficients [N s/m], (N,), of robots whose lowest points are `bottom_w` (N, 3).

        The drag is proportional to the share of `robot_height_m` that is in the grass.
        """
        reach = self.terrain.height(bottom_w[:, :2]) + self.height_m - bottom_w[:, 2]
        share = np.clip(reach / robot_height_m, 0.0, 1.0)
        return self.drag_nspm * self.foliage.density_at(bottom_w) * share


def grow_grass(
    terrain: HeightField, obstacles: Sequence[Mesh], cover: float, height_m: float, seed: int
) -> Grass | None:
    """Patches of grass on a share `cover` of the ground, none below or on `obstacles`; None for cover 0.

    If obstacles and the world's edge leave less ground than that, all of it gets grass.
    """
    if cover <= 0.0:
        return None
    xmin, xmax, ymin, ymax = terrain.extent
    sides = xmax - xmin, ymax - ymin
    columns, rows = (int(np.clip(np.ceil(side / _CELL_M), 4, _MOST_CELLS)) for side in sides)
    cell_x, cell_y = (xmax - xmin) / columns, (ymax - ymin) / rows
    rng = stream(seed, "grass")
    noise = np.zeros((rows, columns))
    for wavelength, weight in zip(_PATCHES_M, (1.0, 0.5), strict=True):
        sigma = (wavelength / 4 / cell_y, wavelength / 4 / cell_x)
        layer = scipy.ndimage.gaussian_filter(rng.standard_normal((rows, columns)), sigma, mode="wrap")
        noise += weight * layer / layer.std()
    free = ~_occupied_cells(terrain, obstacles, rows, columns)
    free[[0, -1]] = free[:, [0, -1]] = False
    count = min(round(cover * rows * columns), int(free.sum()))
    if count == 0:
        return None
    least = np.sort(noise[free])[-count]
    thick = np.clip((noise - least) / (_FULL_DENSITY_AT * noise.std()), 0.0, 1.0)
    density = np.where(free & (noise >= least), _EDGE_DENSITY + (1.0 - _EDGE_DENSITY) * thick, 0.0)
    return Grass(terrain, density.astype(np.float32), height_m)


def _occupied_cells(terrain: HeightField, obstacles: Sequence[Mesh], rows: int, columns: int) -> Flags:
    """Cells (rows, columns) with an obstacle on or above them, and their neighbours."""
    occupied = np.zeros((rows, columns), bool)
    if not obstacles:
        return occupied
    xmin, xmax, ymin, ymax = terrain.extent
    # Vertical rays at twice the cells' resolution find volumes; points on all surfaces find thin walls.
    centres = cell_centres(terrain.extent, 2 * rows, 2 * columns)
    x, y = centres[0, :, 0], centres[:, 0, 1]
    near = np.zeros((2 * rows, 2 * columns), bool)
    for vertices, _ in obstacles:
        low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
        (left, right), (bottom, top) = (
            (np.searchsorted(axis, low[k]), np.searchsorted(axis, high[k], side="right"))
            for k, axis in enumerate((x, y))
        )
        near[bottom:top, left:right] = True
    below = centres[near]
    origins = np.column_stack([below, terrain.height(below) - _CLEARED_BELOW_M]).astype(np.float32)
    upward = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(below), 1))
    # Merged, since hundreds of small meshes take a hundred times as long.
    vertices, faces = merge_meshes(obstacles)
    hit = RayScene(vertices, faces).hit_faces(origins, upward, np.full(len(below), _HIGHEST_M, np.float32))
    cell = min((xmax - xmin) / columns, (ymax - ymin) / rows)
    # Imported here: it takes half a second to load, and reading settings does not need it.
    import trimesh

    surface, _ = trimesh.remesh.subdivide_to_size(vertices, faces, cell, max_iter=20)
    above = surface[:, 2] > terrain.height(surface[:, :2]) - _CLEARED_BELOW_M
    points = np.concatenate([below[hit >= 0], surface[above, :2]])
    column = ((points[:, 0] - xmin) * columns / (xmax - xmin)).astype(np.intp)
    row = ((points[:, 1] - ymin) * rows / (ymax - ymin)).astype(np.intp)
    occupied[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)] = True
    # Density is interpolated between cells, so the neighbours of occupied cells must be bare, too.
    return scipy.ndimage.binary_dilation(occupied, np.ones((3, 3), bool))
