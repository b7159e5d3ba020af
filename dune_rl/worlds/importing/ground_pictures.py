"""Pictures of imported grounds: textures and colours projected from above."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.rendering.light import linear_to_srgb
from dune_rl.rendering.mesh_texture import TextureSampler
from dune_rl.worlds.ground_texture import GroundPicture, texture_shape
from dune_rl.worlds.importing.height_grid import Triangles, cast_down

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
