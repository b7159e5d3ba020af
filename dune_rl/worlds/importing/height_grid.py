"""Regular grids of heights and colours, sampled from triangles by vertical rays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.core.errors import WorldError
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import linear_to_srgb
from dune_rl.rendering.mesh_texture import MeshTexture, TextureSampler
from dune_rl.worlds.ground_texture import GroundPicture, texture_shape

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
    size, unit = high - low, "look whether its unit is right (world.unit_m)"
    said = f"its ground is {size[0]:.3g} by {size[1]:.3g} m, too"
    if size.min() < _SMALLEST_M:
        raise WorldError(f"{said} little to drive on: {unit}.")
    if size.max() > _LARGEST_M:
        raise WorldError(f"{said} much for one world: {unit}, or cut out a piece.")
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
    down = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(xy), 1))
    hit = scene.hit_faces(origins, down, np.full(len(xy), far, np.float32))
    face = np.where(hit >= 0, ground[hit], -1)
    # Heights in double precision, from the triangle's plane, limited to the heights of its corners.
    corner, normal = soup.vertices[soup.faces[face]], soup.normals[face]
    rise = ((xy - corner[:, 0, :2]) * normal[:, :2]).sum(axis=1) / np.maximum(normal[:, 2], 1e-6)
    z = np.clip(corner[:, 0, 2] - rise, corner[..., 2].min(axis=1), corner[..., 2].max(axis=1))
    shape = points.shape[:-1]
    return np.where(face >= 0, z, 0.0).reshape(shape), face.reshape(shape)


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


# Finer than the textures of generated worlds, to keep the detail of the file.
_TEXEL_M = 0.025


def bake_ground_picture(
    soup: Triangles, is_ground: Flags, terrain: HeightField, colours: Floats
) -> GroundPicture | None:
    """The textures of the ground's triangles projected onto `terrain`, None if it has none.

    Parts without a texture get the `colours` (rows, columns, 3) of the terrain's points.
    """
    if soup.texture is None or not (soup.texture.picture[is_ground] >= 0).any():
        return None
    ground = np.flatnonzero(is_ground)
    sampler = TextureSampler(soup.texture.select_faces(ground))
    rows, columns = texture_shape(terrain, _TEXEL_M)
    xmin, xmax, _, _ = terrain.extent
    xy = cell_centres(terrain.extent, rows, columns)
    points = soup.vertices[soup.faces[ground], :2].reshape(-1, 2)
    heights, hit = cast_down(soup, ground, xy, points.min(axis=0), points.max(axis=0))
    # From indices into all triangles to indices into those of the ground; -1 for a miss.
    face = np.where(hit >= 0, np.searchsorted(ground, hit), -1).reshape(-1)
    textured = np.flatnonzero((face >= 0) & sampler.textured[face])
    positions = np.concatenate([xy, heights[..., None]], axis=-1).reshape(-1, 3)[textured]
    picture = resample_to_texels(colours, (rows, columns))
    texel_m = (xmax - xmin) / columns
    picture.reshape(-1, 3)[textured] = linear_to_srgb(
        sampler.albedo(face[textured], positions.astype(np.float32), texel_m)
    )
    detailed = np.zeros(rows * columns, bool)
    detailed[textured] = True
    return GroundPicture(picture, detailed.reshape(rows, columns))


def resample_to_texels(colours: Floats, shape: tuple[int, int]) -> Floats:
    """`colours` (rows, columns, 3) at a terrain's points, interpolated to the centres of `shape` texels."""
    rows, columns = colours.shape[:2]
    at = np.meshgrid(
        *((np.arange(new) + 0.5) / new * (old - 1) for new, old in zip(shape, (rows, columns), strict=True)),
        indexing="ij",
    )
    channels = [ndimage.map_coordinates(colours[..., k], at, order=1, mode="nearest") for k in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def picture_from_colours(terrain: HeightField, colours: Floats) -> GroundPicture:
    """A ground picture of the `colours` (rows, columns, 3) at the terrain's points, without detail."""
    shape = texture_shape(terrain)
    return GroundPicture(resample_to_texels(colours, shape), np.zeros(shape, bool))


def tile_picture(terrain: HeightField, picture: NDArray[np.uint8], tile_m: float) -> GroundPicture:
    """`picture` repeated in tiles of `tile_m` [m] from the terrain's north-west corner, as in Gazebo."""
    rows, columns = texture_shape(terrain, _TEXEL_M)
    xmin, xmax, ymin, ymax = terrain.extent
    x = (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = (np.arange(rows)[::-1] + 0.5) * (ymax - ymin) / rows
    column, row = (
        (along / tile_m % 1.0 * side).astype(np.intp).clip(0, side - 1)
        for along, side in zip((x, y), picture.shape[1::-1], strict=True)
    )
    # A texel of the ground has the mean of the picture's texels that it covers.
    blur = max(1, round((xmax - xmin) / columns / tile_m * picture.shape[1]))
    smooth = ndimage.uniform_filter(picture.astype(np.float32), (blur, blur, 1), mode="wrap") / 255.0
    return GroundPicture(smooth[np.ix_(row, column)], np.ones((rows, columns), bool))
