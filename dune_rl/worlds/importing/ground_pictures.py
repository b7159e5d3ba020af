"""What a ground from a file looks like: its textures and colours as one picture seen from above."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import linear_to_srgb
from dune_rl.rendering.mesh_texture import TextureSampler
from dune_rl.worlds.ground_texture import GroundPicture, texture_shape
from dune_rl.worlds.importing.height_grid import Triangles, cast_down

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

# Finer than the ground of the worlds made here: there is detail to show.
_TEXEL_M = 0.025


def bake_ground_picture(
    soup: Triangles, is_ground: NDArray[np.bool_], terrain: HeightField, colours: Floats
) -> GroundPicture | None:
    """The textures of the ground's triangles on `terrain`, None where it has none.

    Where there is no texture, it is the `colours` (rows, columns, 3) of the terrain's points.
    """
    if soup.texture is None or not (soup.texture.picture[is_ground] >= 0).any():
        return None
    ground = np.flatnonzero(is_ground)
    look = TextureSampler(soup.texture.select_faces(ground))
    rows, columns = texture_shape(terrain, _TEXEL_M)
    xmin, xmax, ymin, ymax = terrain.extent
    x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
    points = soup.vertices[soup.faces[ground], :2].reshape(-1, 2)
    heights, found = cast_down(soup, ground, x, y, points.min(axis=0), points.max(axis=0))
    # From the triangle's number among all to that among the ground's; a miss stays one.
    face = np.where(found >= 0, np.searchsorted(ground, found), -1).reshape(-1)
    shown = np.flatnonzero((face >= 0) & look.textured[face])
    at = np.stack(np.meshgrid(x, y), axis=-1)
    places = np.concatenate([at, heights[..., None]], axis=-1).reshape(-1, 3)[shown]
    picture = resample_to_texels(colours, (rows, columns))
    texel_m = (xmax - xmin) / columns
    picture.reshape(-1, 3)[shown] = linear_to_srgb(
        look.albedo(face[shown], places.astype(np.float32), texel_m)
    )
    detailed = np.zeros(rows * columns, bool)
    detailed[shown] = True
    return GroundPicture(picture, detailed.reshape(rows, columns))


def resample_to_texels(colours: Floats, shape: tuple[int, int]) -> Floats:
    """`colours` (rows, columns, 3) of a terrain's points, between them in the middle of `shape` texels."""
    rows, columns = colours.shape[:2]
    at = np.meshgrid(
        *((np.arange(new) + 0.5) / new * (old - 1) for new, old in zip(shape, (rows, columns), strict=True)),
        indexing="ij",
    )
    channels = [ndimage.map_coordinates(colours[..., k], at, order=1, mode="nearest") for k in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def picture_from_colours(terrain: HeightField, colours: Floats) -> GroundPicture:
    """A picture of the `colours` (rows, columns, 3) of the terrain's points, with no detail of its own."""
    shape = texture_shape(terrain)
    return GroundPicture(resample_to_texels(colours, shape), np.zeros(shape, bool))


def tile_picture(terrain: HeightField, picture: NDArray[np.uint8], tile_m: float) -> GroundPicture:
    """`picture` in tiles `tile_m` wide from the terrain's north-western corner on, as Gazebo lays them."""
    rows, columns = texture_shape(terrain, _TEXEL_M)
    xmin, xmax, ymin, ymax = terrain.extent
    x = (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = (np.arange(rows)[::-1] + 0.5) * (ymax - ymin) / rows
    column, row = (
        (along / tile_m % 1.0 * side).astype(np.intp).clip(0, side - 1)
        for along, side in zip((x, y), picture.shape[1::-1], strict=True)
    )
    # Where a texel of the ground shows many of the picture, it shows their mean.
    blur = max(1, round((xmax - xmin) / columns / tile_m * picture.shape[1]))
    smooth = ndimage.uniform_filter(picture.astype(np.float32), (blur, blur, 1), mode="wrap") / 255.0
    return GroundPicture(smooth[np.ix_(row, column)], np.ones((rows, columns), bool))
