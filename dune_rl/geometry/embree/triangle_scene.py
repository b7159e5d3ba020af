"""Ray packets on Embree: 16 rays per call, several times as fast as single rays."""

import weakref
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.embree.library import ARGUMENTS, build_scene, intersect16, occluded16, release_scene
from dune_rl.geometry.embree.packets import (
    DIRECTION,
    FACE,
    GEOMETRY,
    NONE,
    NORMAL,
    ROWS,
    TFAR,
    WIDTH,
    load_rays,
    new_packet,
)

_NO_ORDER = np.zeros(0, np.int64)


class TriangleScene:
    """Embree scene of triangles: `vertices` (V, 3) and `faces` (F, 3), copied.

    `handle` is its address in the library, valid while the object lives.
    """

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        if not len(vertices) or not len(faces):
            raise ValueError("a ray scene needs at least one triangle")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"faces must index vertices from 0 to {len(vertices) - 1}")
        self.num_faces = len(faces)
        self.handle = build_scene(vertices, faces)
        weakref.finalize(self, release_scene, self.handle)

    def intersect(
        self,
        origins: Floats,
        directions: Floats,
        ranges: Floats,
        faces: NDArray[np.int32],
        normals: Floats,
        order: NDArray[np.int64] | None = None,
    ) -> None:
        """Shorten `ranges` (N,) in place to first hits; fill `faces` (N,), `normals` (N, 3) unless empty.

        The rays of each of the S origins are traced in an `order` (N / S,) of their numbers, in which similar
        ones follow each other; where N / S is no multiple of 16, in turn. Hits do not depend on it.
        """
        _check(origins, directions)
        per_origin = len(directions) // max(1, len(origins))
        if per_origin % WIDTH:
            order = _NO_ORDER
        elif order is None:
            order = counted(per_origin)
        elif len(order) != per_origin:
            raise ValueError(f"an order of {len(order)} is not that of {per_origin} rays of each origin")
        _intersect(
            self.handle,
            ARGUMENTS,
            _contiguous(origins),
            _contiguous(directions),
            order,
            ranges,
            faces,
            normals,
        )

    def occluded(self, origins: Floats, directions: Floats) -> Flags:
        """Whether each ray hits any triangle, (N,)."""
        occluded = np.empty(len(directions), np.bool_)
        _check(origins, directions)
        _occluded(self.handle, ARGUMENTS, _contiguous(origins), _contiguous(directions), occluded)
        return occluded


@lru_cache(maxsize=64)
def counted(count: int) -> NDArray[np.int64]:
    """The order of rays that follow each other, (count,)."""
    return np.arange(count)


def _check(origins: Floats, directions: Floats) -> None:
    # Compiled code would read beyond the arrays' ends.
    if len(directions) and (not len(origins) or len(directions) % len(origins)):
        raise ValueError(f"{len(directions)} rays do not divide evenly among {len(origins)} origins")


def _contiguous(values: Floats) -> Floats:
    # One memory layout, so that each function is compiled once.
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
