"""Pictures on the faces of a mesh, and their colours where a ray meets them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dune_rl.rendering.light import srgb_to_linear

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]

# Sides of pictures: powers of two, so that they halve evenly down to one texel.
_LARGEST = 1024
_LEVELS = _LARGEST.bit_length()
# Of all pictures of a texture together: 16 million are 64 MB with their smaller copies.
_MOST_TEXELS = 2**24
# A picture squeezed into less than this shows nothing but noise, and its map is lost in rounding.
_SMALLEST_TILE_M = 1e-3


@dataclass(frozen=True, eq=False)
class MeshTexture:
    """`pictures` (rows, columns, 3), bytes in sRGB, and where each of F faces shows them.

    `picture` (F,) is the index of a face's picture, -1 where it has none. `maps` (F, 2, 4) take a point
    (x, y, z, 1) on a face to u and v: 0 to 1 from the picture's lower left, which is repeated beyond.
    """

    pictures: tuple[Bytes, ...]
    picture: NDArray[np.int32]
    maps: Array

    @classmethod
    def of(cls, picture: Bytes, corners: Array, uv: Array) -> Self:
        """`picture` on faces with `corners` (F, 3, 3) and their `uv` (F, 3, 2); none where they are unfit."""
        with np.errstate(all="ignore"):
            first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
            normal = np.cross(first, second)
            # The dual basis of the two edges: how far along each of them a point lies.
            along = np.stack([np.cross(second, normal), np.cross(normal, first)], axis=1)
            along /= (normal * normal).sum(axis=1)[:, None, None]
            change = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
            maps = np.zeros((len(corners), 2, 4))
            maps[..., :3] = np.einsum("fku,fkx->fux", change, along)
            maps[..., 3] = uv[:, 0] - np.einsum("fux,fx->fu", maps[..., :3], corners[:, 0])
            fit = np.isfinite(maps).all(axis=(1, 2)) & (np.abs(uv) < 1e5).all(axis=(1, 2))
        maps[~fit] = 0.0
        return cls((picture,), np.where(fit, 0, -1).astype(np.int32), maps)

    def select_faces(self, faces: NDArray[Any]) -> "MeshTexture":
        """That of some faces: their indices, or a mask."""
        return MeshTexture(self.pictures, self.picture[faces], self.maps[faces])

    def transform(self, matrix: Array) -> "MeshTexture | None":
        """The same on a mesh moved by a transform (4, 4), None where that is flat."""
        try:
            return MeshTexture(self.pictures, self.picture, self.maps @ np.linalg.inv(matrix))
        except np.linalg.LinAlgError:
            return None


def join_textures(textures: Sequence[MeshTexture | None], counts: Sequence[int]) -> MeshTexture | None:
    """Those of several meshes of `counts` faces as one; None where none has any picture."""
    if not any(texture is not None and (texture.picture >= 0).any() for texture in textures):
        return None
    number: dict[int, int] = {}
    pictures: list[Bytes] = []
    index = [np.zeros(0, np.int32)]
    for texture, count in zip(textures, counts, strict=True):
        if texture is None:
            index.append(np.full(count, -1, np.int32))
            continue
        for used in np.unique(texture.picture[texture.picture >= 0]):
            if id(texture.pictures[used]) not in number:
                number[id(texture.pictures[used])] = len(pictures)
                pictures.append(texture.pictures[used])
        new = np.array([*(number.get(id(picture), -1) for picture in texture.pictures), -1], np.int32)
        index.append(new[texture.picture])
    maps = [
        np.zeros((count, 2, 4)) if texture is None else texture.maps
        for texture, count in zip(textures, counts, strict=True)
    ]
    return MeshTexture(tuple(pictures), np.concatenate(index), np.concatenate(maps))


class TextureSampler:
    """A `MeshTexture` made ready for rays: its pictures in all sizes, so that far ones do not flicker.

    `textured` (F,) tells of which faces there are colours.
    """

    def __init__(self, texture: MeshTexture, most_texels: int = _MOST_TEXELS) -> None:
        pictures = [_halving(picture) for picture in texture.pictures]
        while sum(picture.shape[0] * picture.shape[1] for picture in pictures) > most_texels:
            pictures = [_halved(picture) for picture in pictures]
        # The first texel and the sides of each picture in each size.
        self._starts = np.zeros((len(pictures), _LEVELS), np.int64)
        self._sides = np.ones((len(pictures), _LEVELS, 2), np.int32)
        texels, start = [], 0
        for number, picture in enumerate(pictures):
            for level in range(_LEVELS):
                self._starts[number, level] = start
                self._sides[number, level] = picture.shape[1::-1]
                if picture.shape[:2] == (1, 1) and level + 1 < _LEVELS:
                    continue
                texels.append(picture.reshape(-1, 3))
                start += len(texels[-1])
                picture = _halved(picture)
        self._texels = np.concatenate(texels)
        self._linear = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255.0))
        self._picture = texture.picture
        self._maps = texture.maps.astype(np.float32)
        sides = self._sides[np.maximum(texture.picture, 0), 0]
        # Texels a metre, the most of both ways across the picture.
        density = np.linalg.norm(self._maps[..., :3], axis=2)
        fine = (density > 1.0 / _SMALLEST_TILE_M).any(axis=1)
        self.textured: NDArray[np.bool_] = (texture.picture >= 0) & ~fine
        self._sharpness = np.log2(np.maximum((density * sides).max(axis=1), 1e-9)).astype(np.float32)

    def albedo(
        self, face: NDArray[Any], points: Floats, pixel_m: Floats | float, *, smooth: bool = False
    ) -> Floats:
        """Linear RGB (N, 3) at `points` (N, 3) on faces `face` (N,), seen in pixels `pixel_m` wide.

        `smooth` is between texels, for pictures seen from near; else it is that of the nearest texel.
        """
        maps = self._maps[face]
        at = np.einsum("nux,nx->nu", maps[..., :3], points) + maps[..., 3]
        at -= np.floor(at)
        level = self._sharpness[face] + np.log2(np.maximum(pixel_m, np.float32(1e-6)))
        level = np.clip(level + 0.5, 0, _LEVELS - 1).astype(np.intp)
        picture = self._picture[face]
        start, sides = self._starts[picture, level], self._sides[picture, level]
        # Pictures have their first row at the top.
        column, row = at[:, 0] * sides[:, 0], (np.float32(1.0) - at[:, 1]) * sides[:, 1]
        if not smooth:
            return self._linear[self._texel(start, sides, column, row)]
        column, row = column - np.float32(0.5), row - np.float32(0.5)
        left, top = np.floor(column), np.floor(row)
        right_share, low_share = (column - left)[:, None], (row - top)[:, None]
        upper, lower = (
            self._linear[self._texel(start, sides, left, line)] * (1 - right_share)
            + self._linear[self._texel(start, sides, left + 1, line)] * right_share
            for line in (top, top + 1)
        )
        mixed: Floats = upper * (1 - low_share) + lower * low_share
        return mixed

    def _texel(
        self, start: NDArray[np.int64], sides: NDArray[np.int32], column: Floats, row: Floats
    ) -> Bytes:
        x = column.astype(np.int32) & (sides[:, 0] - 1)
        y = row.astype(np.int32) & (sides[:, 1] - 1)
        texel: Bytes = self._texels[start + y * sides[:, 0] + x]
        return texel


def _halving(picture: Bytes) -> Bytes:
    """The picture with sides that are powers of two, each the nearest that is not above the largest."""
    rows, columns = (_power(side) for side in picture.shape[:2])
    if (rows, columns) == picture.shape[:2]:
        return picture
    return np.asarray(Image.fromarray(picture).resize((columns, rows), Image.Resampling.BOX))


def _power(side: int) -> int:
    return int(min(_LARGEST, 2 ** round(np.log2(side))))


def _halved(picture: Bytes) -> Bytes:
    rows, columns = picture.shape[0] // 2, picture.shape[1] // 2
    found = picture.astype(np.uint16)
    if rows:
        found = (found[::2] + found[1::2] + 1) // 2
    if columns:
        found = (found[:, ::2] + found[:, 1::2] + 1) // 2
    return found.astype(np.uint8)
