"""Loops over the pixels of pictures: colours of what rays meet, and depths."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_BYTE = np.uint32(255)


def tile_order(height: int, width: int, size: int = 4) -> Any:
    """Numbers (height * width,) of a picture's pixels, one square tile of `size` pixels after the other.

    Rays of a tile meet nearly the same things, so that packets of them are traced faster than rows.
    """
    row, column = np.divmod(np.arange(height * width), width)
    return np.lexsort((column % size, row % size, column // size, row // size))


@compile_function
def look_up_colours(
    directions: Any, ranges: Any, faces: Any, start: Any, texels: Any, last: Any, columns: int, ground: Any,
    ground_faces: int, colours: Any, sky: Any, found: Any,
) -> None:  # fmt: skip
    """Packed colours `found` (N,) of rays that meet `faces` (N,), -1 for none, at `ranges` (N,).

    `start` (M, 2) is where the rays of each picture start on the map of the ground, in texels; `texels` (2,)
    are texels per metre, `last` (2,) the last of each axis; `colours` (F,) those of all faces, of which the
    first `ground_faces` have the map's instead.
    """
    pixels = len(faces) // len(start)
    half = np.float32(len(sky) / 2)
    for picture in range(len(start)):
        x, y = start[picture, 0], start[picture, 1]
        for ray in range(picture * pixels, (picture + 1) * pixels):
            face = faces[ray]
            if face < 0:
                level = np.int64((directions[ray, 2] + _ONE) * half)
                found[ray] = sky[min(max(level, 0), len(sky) - 1)]
            elif face < ground_faces:
                along = ranges[ray]
                column = directions[ray, 0] * along * texels[0] + x
                row = directions[ray, 1] * along * texels[1] + y
                column = min(max(column, _ZERO), last[0])
                row = min(max(row, _ZERO), last[1])
                found[ray] = ground[np.int64(row) * columns + np.int64(column)]
            else:
                found[ray] = colours[face]


@compile_function
def unpack_colours(colours: Any, found: Any) -> None:
    """Red, green and blue `found` (N, 3) of packed `colours` (N,)."""
    for pixel in range(len(colours)):
        word = colours[pixel]
        found[pixel, 0] = word & _BYTE
        found[pixel, 1] = (word >> np.uint32(8)) & _BYTE
        found[pixel, 2] = (word >> np.uint32(16)) & _BYTE


@compile_function
def depths_along_axis(ranges: Any, cosines: Any, farthest: Any, found: Any) -> None:
    """Depths `found` (M, P): `ranges` (M, P) by the rays' `cosines` (P,), `farthest` where nothing is met."""
    for picture in range(ranges.shape[0]):
        for pixel in range(ranges.shape[1]):
            along = ranges[picture, pixel]
            found[picture, pixel] = farthest if along >= farthest else along * cosines[pixel]
