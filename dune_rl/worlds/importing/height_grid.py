"""Regular grids of heights, sampled from triangles by vertical rays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.core.errors import WorldError
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.mesh_texture import MeshTexture

# A million points take a gigabyte of memory with everything computed from them, and half a minute to build.
MAX_POINTS = 1_000_000

_DEFAULT_POINTS = 80_000
_FINEST_M = 0.05
_SMALLEST_M, _LARGEST_M = 0.5, 20_000.0


class Triangles(NamedTuple):
    """All triangles of a world, in the order of its parts.

    `vertices` (V, 3) [m], `faces` (F, 3), `colours` (F, 3), unit `normals` (F, 3) and `areas` (F,) [m2].
    `claim` (F,) is 1 for declared ground, -1 for triangles declared not to be ground, 0 for the others.
    """

    vertices: Array
    faces: NDArray[np.int32]
    colours: Floats
    claim: NDArray[np.int8]
    normals: Array
    areas: Array
    texture: MeshTexture | None = None


def ground_extent(soup: Triangles, ground: Flags) -> tuple[Array, Array]:
    """Lowest and highest x and y, each (2,) [m], of the triangles in `ground` (F,).

    Raises `WorldError` if the ground is too small or too large.
    """
    points = soup.vertices[soup.faces[ground], :2].reshape(-1, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    if (high - low).min() < _SMALLEST_M:
        raise WorldError(
            f"its ground is {high[0] - low[0]:.3g} by {high[1] - low[1]:.3g} m, too little to drive on: "
            "look whether its unit is right (world.unit_m)."
        )
    if (high - low).max() > _LARGEST_M:
        raise WorldError(
            f"its ground is {high[0] - low[0]:.3g} by {high[1] - low[1]:.3g} m, too much for one world: "
            "look whether its unit is right (world.unit_m), or cut out a piece."
        )
    return low, high


def grid_spacing(low: Array, high: Array, spacing_m: float | None) -> float:
    """The spacing [m] of the grid: `spacing_m`, or by default one chosen for the ground's size."""
    width, depth = high - low
    if spacing_m is None:
        least = max(_FINEST_M, float(np.sqrt(width * depth / _DEFAULT_POINTS)))
        # A whole number of cells from edge to edge.
        return float(width / max(1.0, np.floor(width / least + 1e-9)))
    check_grid_size(width, depth, spacing_m, "ground")
    return spacing_m


def check_grid_size(width: float, depth: float, spacing_m: float, what: str) -> None:
    """Raise `WorldError` if a grid over `width` by `depth` [m] has too many points, or no cell."""
    if (width / spacing_m + 1) * (depth / spacing_m + 1) > MAX_POINTS:
        least = 1.01 * float(np.sqrt(width * depth / MAX_POINTS))
        raise WorldError(
            f"world.spacing_m={spacing_m:g} makes more than {MAX_POINTS:,} points: "
            f"set it to {least:.2g} or more."
        )
    if min(width, depth) < spacing_m:
        raise WorldError(
            f"world.spacing_m={spacing_m:g} is more than the {what}'s {min(width, depth):.2f} m: lower it."
        )


def grid_axes(low: Array, high: Array, step: float) -> tuple[Array, Array, tuple[float, float]]:
    """Coordinates x (columns,) and y (rows,) [m] of the grid's points, and the first point."""
    cells = np.maximum(np.floor((high - low) / step + 1e-6).astype(int), 1)
    start = (low + high - cells * step) / 2
    x, y = (start[k] + step * np.arange(cells[k] + 1) for k in (0, 1))
    return x, y, (float(start[0]), float(start[1]))


def cast_down(
    soup: Triangles, ground: NDArray[np.intp], points: Array, low: Array, high: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Heights (...) of the topmost triangle of `ground` at points (..., 2), and its index, -1 for none."""
    # Rays exactly at the edge may miss it by a rounding error.
    inside = 1e-6 * (high - low) + 1e-6
    xy = np.clip(points, low + inside, high - inside).reshape(-1, 2)
    middle = (low + high) / 2
    # Centred at the origin, where single precision is finest.
    vertices = soup.vertices - [*middle, 0.0]
    top = float(vertices[:, 2].max()) + 1.0
    far = top - float(vertices[:, 2].min()) + 1.0
    scene = RayScene(vertices, soup.faces[ground])
    origins = np.column_stack([xy - middle, np.full(len(xy), top)]).astype(np.float32)
    down = np.zeros_like(origins)
    down[:, 2] = -1.0
    hits = scene.hits(origins, down, np.full(len(xy), far, np.float32))
    face = np.where(hits.face >= 0, ground[hits.face], -1)
    heights = np.where(face >= 0, _plane_height(soup, face, xy), 0.0)
    return heights.reshape(points.shape[:-1]), face.reshape(points.shape[:-1])


def _plane_height(soup: Triangles, face: NDArray[np.intp], xy: Array) -> Array:
    # In double precision, from the triangle's plane, limited to the heights of its corners.
    corner = soup.vertices[soup.faces[face]]
    normal = soup.normals[face]
    z = corner[:, 0, 2] - ((xy - corner[:, 0, :2]) * normal[:, :2]).sum(axis=1) / np.maximum(
        normal[:, 2], 1e-6
    )
    return np.clip(z, corner[..., 2].min(axis=1), corner[..., 2].max(axis=1))


def fill_gaps(values: Array, known: Flags) -> Array:
    """`values` (rows, columns) with a smooth surface where they are not `known`."""
    if known.all():
        return np.asarray(values, np.float64)
    index = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    out = np.asarray(values, np.float64)[tuple(index)]
    # From coarse to fine: each radius smooths what the larger one left rough.
    for radius in (16, 8, 4, 2, 1):
        for _ in range(12):
            smooth = ndimage.uniform_filter(out, 2 * radius + 1, mode="nearest")
            out = np.where(known, out, smooth)
    return out
