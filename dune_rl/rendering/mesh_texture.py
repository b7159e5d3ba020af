"""Textures of meshes: pictures mapped to faces, and their colours at any point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dune_rl.geometry.arrays import Array, Bytes, Flags, Floats
from dune_rl.rendering.light import srgb_to_linear

# Largest side of a picture: sides are powers of two, so that mipmaps halve evenly down to one texel.
_LARGEST = 1024
_LEVELS = _LARGEST.bit_length()
# Texels of all pictures of a mesh: 16 million are 64 MB with their mipmaps.
_MOST_TEXELS = 2**24
# A picture repeated at smaller intervals would only be noise, and its map would be lost to rounding.
_SMALLEST_TILE_M = 1e-3


@dataclass(frozen=True, eq=False)
class MeshTexture:
    """`pictures` (rows, columns, 3) of sRGB bytes, and their maps to F faces.

    `picture` (F,) is the index of a face's picture, -1 for none. `maps` (F, 2, 4) transform a point
    (x, y, z, 1) on a face to u and v, which run from 0 at the picture's lower left to 1; it repeats beyond.
    """

    pictures: tuple[Bytes, ...]
    picture: NDArray[np.int32]
    maps: Array

    @classmethod
    def from_uv(cls, picture: Bytes, corners: Array, uv: Array) -> Self:
        """`picture` on faces with `corners` (F, 3, 3) and their `uv` (F, 3, 2); none where uv is invalid."""
        with np.errstate(all="ignore"):
            first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
            normal = np.cross(first, second)
            # The dual basis of the two edges gives a point's coordinates along them.
            along = np.stack([np.cross(second, normal), np.cross(normal, first)], axis=1)
            along /= (normal * normal).sum(axis=1)[:, None, None]
            change = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
            maps = np.zeros((len(corners), 2, 4))
            maps[..., :3] = np.einsum("fku,fkx->fux", change, along)
            maps[..., 3] = uv[:, 0] - np.einsum("fux,fx->fu", maps[..., :3], corners[:, 0])
            valid = np.isfinite(maps).all(axis=(1, 2)) & (np.abs(uv) < 1e5).all(axis=(1, 2))
        maps[~valid] = 0.0
        return cls((picture,), np.where(valid, 0, -1).astype(np.int32), maps)

    def uv(self, faces: NDArray[Any], points: Array) -> Array:
        """Coordinates (F, K, 2) of `points` (F, K, 3) on some faces, given by indices or a mask."""
        maps = self.maps[faces]
        uv: Array = np.einsum("fux,fkx->fku", maps[..., :3], points) + maps[:, None, :, 3]
        return uv

    def select_faces(self, faces: NDArray[Any]) -> "MeshTexture":
        """The texture of some faces, given by indices or a mask."""
        return MeshTexture(self.pictures, self.picture[faces], self.maps[faces])

    def transform(self, matrix: Array) -> "MeshTexture | None":
        """The same texture on a mesh transformed by `matrix` (4, 4); None if that is singular."""
        try:
            return MeshTexture(self.pictures, self.picture, self.maps @ np.linalg.inv(matrix))
        except np.linalg.LinAlgError:
            return None


def join_textures(textures: Sequence[MeshTexture | None], counts: Sequence[int]) -> MeshTexture | None:
    """The textures of several meshes of `counts` faces as one; None if none has a picture."""
    if not any(texture is not None and (texture.picture >= 0).any() for texture in textures):
        return None
    number: dict[int, int] = {}
    pictures: list[Bytes] = []
    index, maps = [], []
    for texture, count in zip(textures, counts, strict=True):
        if texture is None:
            index.append(np.full(count, -1, np.int32))
            maps.append(np.zeros((count, 2, 4)))
            continue
        for used in np.unique(texture.picture[texture.picture >= 0]):
            if id(texture.pictures[used]) not in number:
                number[id(texture.pictures[used])] = len(pictures)
                pictures.append(texture.pictures[used])
        new = np.array([*(number.get(id(picture), -1) for picture in texture.pictures), -1], np.int32)
        index.append(new[texture.picture])
        maps.append(texture.maps)
    return MeshTexture(tuple(pictures), np.concatenate(index), np.concatenate(maps))


class TextureSampler:
    """Samples a `MeshTexture` with mipmaps, so that distant textures do not flicker.

    `textured` (F,) marks the faces that have colours.
    """

    def __init__(self, texture: MeshTexture, most_texels: int = _MOST_TEXELS) -> None:
        pictures = [_resize_to_powers_of_two(picture) for picture in texture.pictures]
        while sum(picture.shape[0] * picture.shape[1] for picture in pictures) > most_texels:
            pictures = [_halve(picture) for picture in pictures]
        # Index of the first texel, and the sides, of each level of each picture.
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
                picture = _halve(picture)
        self._texels = np.concatenate(texels)
        self._linear = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255.0))
        self._picture = texture.picture
        self._maps = texture.maps.astype(np.float32)
        sides = self._sides[np.maximum(texture.picture, 0), 0]
        # Texels per metre, the larger value of both directions.
        density = np.linalg.norm(self._maps[..., :3], axis=2)
        fine = (density > 1.0 / _SMALLEST_TILE_M).any(axis=1)
        self.textured: Flags = (texture.picture >= 0) & ~fine
        self._sharpness = np.log2(np.maximum((density * sides).max(axis=1), 1e-9)).astype(np.float32)

    def albedo(
        self, face: NDArray[Any], points: Floats, pixel_m: Floats | float, *, smooth: bool = False
    ) -> Floats:
        """Linear RGB (N, 3) at `points` (N, 3) on faces `face` (N,), for pixels of `pixel_m` [m].

        `smooth` interpolates between texels, for near views; else the nearest texel is used.
        """
        maps = self._maps[face]
        at = np.einsum("nux,nx->nu", maps[..., :3], points) + maps[..., 3]
        at -= np.floor(at)
        level = self._sharpness[face] + np.log2(np.maximum(pixel_m, np.float32(1e-6)))
        level = np.clip(level + 0.5, 0, _LEVELS - 1).astype(np.intp)
        picture = self._picture[face]
        start, sides = self._starts[picture, level], self._sides[picture, level]
        # The first row of a picture is its top.
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
        return upper * (1 - low_share) + lower * low_share

    def _texel(
        self, start: NDArray[np.int64], sides: NDArray[np.int32], column: Floats, row: Floats
    ) -> Bytes:
        x, y = column.astype(np.int32) & (sides[:, 0] - 1), row.astype(np.int32) & (sides[:, 1] - 1)
        return self._texels[start + y * sides[:, 0] + x]


def _resize_to_powers_of_two(picture: Bytes) -> Bytes:
    """The picture with each side resized to the nearest power of two, at most `_LARGEST`."""
    rows, columns = (int(min(_LARGEST, 2 ** round(np.log2(side)))) for side in picture.shape[:2])
    if (rows, columns) == picture.shape[:2]:
        return picture
    return np.asarray(Image.fromarray(picture).resize((columns, rows), Image.Resampling.BOX))


def _halve(picture: Bytes) -> Bytes:
    rows, columns = picture.shape[0] // 2, picture.shape[1] // 2
    mean = picture.astype(np.uint16)
    if rows:
        mean = (mean[::2] + mean[1::2] + 1) // 2
    if columns:
        mean = (mean[:, ::2] + mean[:, 1::2] + 1) // 2
    return mean.astype(np.uint8)
