"""Ray casting against triangle meshes, in packets of 16 rays."""

import weakref
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.embree import (
    ARGUMENTS,
    DIRECTION,
    FACE,
    GEOMETRY,
    NONE,
    NORMAL,
    ROWS,
    TFAR,
    WIDTH,
    build_scene,
    intersect16,
    load_rays,
    new_packet,
    occluded16,
    release_scene,
)

Order = NDArray[np.int64] | None

_NO_FACES, _NO_NORMALS, _NO_ORDER = np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros(0, np.int64)


class Hits(NamedTuple):
    """First hits of N rays: face indices (N,), -1 for a miss; ranges (N,); unnormalised normals (N, 3)."""

    face: NDArray[np.int32]
    range: Floats
    normal: Floats


class RayScene:
    """A static set of triangles to cast rays against: an Embree scene, at the address `handle`.

    `vertices` (V, 3) [m] and `faces` (F, 3) are copied. A `short_lived` scene is built in a quarter of the
    time, and its rays take somewhat longer. Rays have C-contiguous float32 `origins` (S, 3) and `directions`
    (N, 3): each origin serves N / S consecutive rays. Ranges are metres if directions have unit
    length. Rays are cast in packets of 16 consecutive ones, which is fastest where their directions are
    similar. `order` (N / S,) has the numbers of the rays of each origin in another order, such as square
    tiles of a picture: results are the same, sooner. Where N / S is no multiple of 16, it is ignored.
    """

    def __init__(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer], *, short_lived: bool = False
    ) -> None:
        if not len(vertices) or not len(faces):
            raise ValueError("a ray scene needs at least one triangle")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"faces must index vertices from 0 to {len(vertices) - 1}")
        self.num_faces = len(faces)
        self._heights = float(vertices[:, 2].min()), float(vertices[:, 2].max())
        self.handle = build_scene(vertices, faces, short_lived=short_lived)
        weakref.finalize(self, release_scene, self.handle)

    def select_scenes(self, scenes: NDArray[np.int64]) -> "RayScene":
        """Itself, since all scenes share it; see `BatchedRayScenes`."""
        return self

    def shorten_ranges(
        self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None
    ) -> None:
        """Shorten `ranges` (N,) in place to the first hit.

        A range that is already shorter than the first hit stays as it is, so that several ray scenes can be
        queried one after another.
        """
        self._cast(origins, directions, ranges, _NO_FACES, _NO_NORMALS, order)

    def hit_faces(
        self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None
    ) -> NDArray[np.int32]:
        """Faces of the first hits, (N,), -1 for a miss; `ranges` (N,) are shortened in place."""
        faces = np.empty(len(directions), np.int32)
        self._cast(origins, directions, ranges, faces, _NO_NORMALS, order)
        return faces

    def hits(self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None) -> Hits:
        """First hits of the rays; `ranges` (N,) are shortened in place as by `shorten_ranges`."""
        faces = np.empty(len(directions), np.int32)
        normals = np.empty((len(directions), 3), np.float32)
        self._cast(origins, directions, ranges, faces, normals, order)
        return Hits(faces, ranges, normals)

    def _cast(
        self,
        origins: Floats,
        directions: Floats,
        ranges: Floats,
        faces: NDArray[np.int32],
        normals: Floats,
        order: Order,
    ) -> None:
        """Shorten `ranges` (N,) in place; fill `faces` (N,) and `normals` (N, 3) unless they are empty."""
        _check(origins, directions)
        per_origin = len(directions) // max(1, len(origins))
        if per_origin % WIDTH:
            order = _NO_ORDER
        elif order is None:
            order = counted(per_origin)
        elif len(order) != per_origin:
            raise ValueError(f"an order of {len(order)} is not that of {per_origin} rays of each origin")
        rays = contiguous(origins), contiguous(directions)
        _intersect(self.handle, ARGUMENTS, *rays, order, ranges, faces, normals)

    def first_hit(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], range_m: float
    ) -> tuple[Floats, Floats]:
        """Range to the first hit (N,), `range_m` for a miss, and its normal (N, 3), not normalised."""
        ranges = np.full(len(directions), range_m, np.float32)
        hit = self.hits(
            np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32), ranges
        )
        return hit.range, hit.normal

    def topmost(self, xy: Array, top_m: float | None = None, reach_m: float | None = None) -> Array:
        """Heights (N,) [m] of the first surface below `top_m` at points (N, 2), -inf beyond `reach_m`.

        By default, all surfaces are between these.
        """
        low, high = self._heights
        top_m = high + 1.0 if top_m is None else top_m
        reach_m = top_m - low + 1.0 if reach_m is None else reach_m
        origins = np.column_stack([xy, np.full(len(xy), top_m)])
        hit, _ = self.first_hit(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape), reach_m)
        return np.where(hit < reach_m, top_m - hit, -np.inf)

    def any_hit(self, origins: Floats, directions: Floats) -> Flags:
        """Whether each ray, of unlimited length, hits any triangle, (N,)."""
        occluded = np.empty(len(directions), np.bool_)
        _check(origins, directions)
        _occluded(self.handle, ARGUMENTS, contiguous(origins), contiguous(directions), occluded)
        return occluded


@lru_cache(maxsize=64)
def counted(count: int) -> NDArray[np.int64]:
    """The order of rays that follow each other, (count,)."""
    return np.arange(count)


def _check(origins: Floats, directions: Floats) -> None:
    # Compiled code would read beyond the arrays' ends.
    if len(directions) and (not len(origins) or len(directions) % len(origins)):
        raise ValueError(f"{len(directions)} rays do not divide evenly among {len(origins)} origins")


def contiguous(values: Floats) -> Floats:
    """`values` in the one memory layout for which functions are compiled."""
    values = np.ascontiguousarray(values, np.float32)
    return values if values.flags.writeable else values.copy()


@compile_function
def _intersect(
    scene: int,
    arguments: int,
    origins: Any,
    directions: Any,
    order: Any,
    ranges: Any,
    faces: Any,
    normals: Any,
) -> None:
    words, numbers = new_packet()
    mask, packet = words[ROWS:].ctypes.data, words.ctypes.data
    rays = np.empty(WIDTH, np.int64)
    per_origin = len(directions) // max(1, len(origins))
    loaded = -1
    for first in range(0, len(directions), WIDTH):
        count = min(WIDTH, len(directions) - first)
        if len(order):
            # Packets are full and have one origin each, which is copied when it changes.
            origin = first // per_origin
            if origin != loaded:
                for axis in range(3):
                    for k in range(WIDTH):
                        numbers[axis, k] = origins[origin, axis]
                loaded = origin
            before = origin * per_origin
            for k in range(WIDTH):
                ray = before + order[first - before + k]
                rays[k] = ray
                for axis in range(3):
                    numbers[DIRECTION + axis, k] = directions[ray, axis]
        else:
            count = load_rays(words, numbers, origins, directions, per_origin, first)
            for k in range(count):
                rays[k] = first + k
        for k in range(count):
            numbers[TFAR, k] = ranges[rays[k]]
            words[GEOMETRY, k] = NONE
        intersect16(mask, scene, packet, arguments)
        for k in range(count):
            ranges[rays[k]] = numbers[TFAR, k]
        if len(faces):
            for k in range(count):
                hit = words[GEOMETRY, k] != NONE
                faces[rays[k]] = np.int32(words[FACE, k]) if hit else np.int32(-1)
        if len(normals):
            for k in range(count):
                hit = words[GEOMETRY, k] != NONE
                for axis in range(3):
                    normals[rays[k], axis] = numbers[NORMAL + axis, k] if hit else np.float32(0.0)


@compile_function
def _occluded(scene: int, arguments: int, origins: Any, directions: Any, blocked: Any) -> None:
    words, numbers = new_packet()
    per_origin = len(directions) // max(1, len(origins))
    for first in range(0, len(directions), WIDTH):
        count = load_rays(words, numbers, origins, directions, per_origin, first)
        for k in range(count):
            numbers[TFAR, k] = np.float32(np.inf)
        occluded16(words[ROWS:].ctypes.data, scene, words.ctypes.data, arguments)
        for k in range(count):
            # Embree marks an occluded ray by a negative range.
            blocked[first + k] = numbers[TFAR, k] < 0.0
