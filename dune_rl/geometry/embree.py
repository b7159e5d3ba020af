"""Ray packets on Embree: 16 rays per call, several times as fast as single rays.

The shared library is the one in the embreex package. embreex itself casts
single rays; this module binds the packet functions of the same library.
Memory layouts follow embree4/rtcore_ray.h and rtcore_common.h (Embree 4).
"""

import ctypes
import weakref
from functools import lru_cache
from typing import Any, NamedTuple

import embreex.rtcore_scene
import llvmlite.binding
import numpy as np
from numba import types
from numpy.typing import NDArray

from dune_rl.compiled import compile_function

_WIDTH = 16
# A packet has rows of 16 words: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask, id and flags 9-11;
# then the hit: normal 12-14, u and v 15-16, face 17, geometry 18, instance 19.
_ROWS = 24
_TNEAR, _TIME, _TFAR, _MASK, _ID, _FLAGS = 3, 7, 8, 9, 10, 11
_NORMAL, _FACE, _GEOMETRY, _INSTANCE = 12, 17, 18, 19
_NONE = np.uint32(0xFFFFFFFF)
_ALL_FEATURES = 0xFFFFFFFF
_COHERENT = 1 << 16
_ROBUST = 1 << 2
_TRIANGLES, _INDICES, _VERTICES, _UINT3, _FLOAT3 = 0, 0, 1, 0x5003, 0x9003

_extension = embreex.rtcore_scene.__file__
_library = ctypes.CDLL(_extension)
# Compiled code, cached or not, finds the functions by name.
llvmlite.binding.load_library_permanently(_extension)


def _function(name: str, result: Any, *arguments: Any) -> Any:
    function = getattr(_library, name)
    function.restype, function.argtypes = result, arguments
    return function


_pointer = ctypes.c_void_p
_new_device = _function("rtcNewDevice", _pointer, ctypes.c_char_p)
_new_scene = _function("rtcNewScene", _pointer, _pointer)
_set_scene_flags = _function("rtcSetSceneFlags", None, _pointer, ctypes.c_int)
_release_scene = _function("rtcReleaseScene", None, _pointer)
_commit_scene = _function("rtcCommitScene", None, _pointer)
_new_geometry = _function("rtcNewGeometry", _pointer, _pointer, ctypes.c_int)
_commit_geometry = _function("rtcCommitGeometry", None, _pointer)
_release_geometry = _function("rtcReleaseGeometry", None, _pointer)
_attach_geometry = _function("rtcAttachGeometry", ctypes.c_uint, _pointer, _pointer)
_new_buffer = _function(
    "rtcSetNewGeometryBuffer",
    _pointer,
    *(_pointer, ctypes.c_int, ctypes.c_uint, ctypes.c_int, ctypes.c_size_t, ctypes.c_size_t),
)
_packet_function = types.void(types.intp, types.intp, types.intp, types.intp)
_intersect16: Any = types.ExternalFunction("rtcIntersect16", _packet_function)
_occluded16: Any = types.ExternalFunction("rtcOccluded16", _packet_function)


class _Arguments(ctypes.Structure):
    # RTCIntersectArguments; RTCOccludedArguments has the same layout. `room` is for fields of later versions.
    _fields_ = (
        ("flags", ctypes.c_uint),
        ("features", ctypes.c_uint),
        ("pointers", _pointer * 3),
        ("room", ctypes.c_uint * 8),
    )


_arguments = _Arguments(_COHERENT, _ALL_FEATURES)
_ARGUMENTS = ctypes.addressof(_arguments)
_NO_ORDER = np.zeros(0, np.int64)


class PosedHits(NamedTuple):
    """What H rays have hit of copies of a scene: rays, faces and copies (H,), numbered through all rows.

    Normals (H, 3) are not normalised, and in the scene's frame.
    """

    ray: NDArray[np.int64]
    face: NDArray[np.int32]
    copy: NDArray[np.int64]
    normal: NDArray[np.float32]


_NO_HITS = PosedHits(
    np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
)
_device: int | None = None


def _shared_device() -> int:
    # One device serves every scene of a process, since each device costs threads and memory.
    global _device
    if _device is None:
        _device = _new_device(b"threads=1,set_affinity=0")
        if not _device:
            raise RuntimeError("Embree could not be started on this machine")
    return _device


class TriangleScene:
    """Embree scene of triangles: `vertices` (V, 3) and `faces` (F, 3), copied."""

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        if not len(vertices) or not len(faces):
            raise ValueError("a ray scene needs at least one triangle")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(f"faces must index vertices from 0 to {len(vertices) - 1}")
        device = _shared_device()
        self._handle = _new_scene(device)
        # Without this flag, rays exactly along an edge pass between two triangles.
        _set_scene_flags(self._handle, _ROBUST)
        weakref.finalize(self, _release_scene, self._handle)
        geometry = _new_geometry(device, _TRIANGLES)
        for slot, layout, values in ((_VERTICES, _FLOAT3, vertices), (_INDICES, _UINT3, faces)):
            kind = ctypes.c_float if slot == _VERTICES else ctypes.c_uint
            address = _new_buffer(geometry, slot, 0, layout, 12, len(values))
            buffer = ctypes.cast(address, ctypes.POINTER(kind))
            np.ctypeslib.as_array(buffer, (len(values), 3))[:] = values
        _commit_geometry(geometry)
        _attach_geometry(self._handle, geometry)
        _release_geometry(geometry)
        _commit_scene(self._handle)

    def intersect(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        ranges: NDArray[np.float32],
        faces: NDArray[np.int32],
        normals: NDArray[np.float32],
        order: NDArray[np.int64] | None = None,
    ) -> None:
        """Shorten `ranges` (N,) in place to first hits; fill `faces` (N,), `normals` (N, 3) unless empty.

        The rays of each of the S origins are traced in an `order` (N / S,) of their numbers, in which similar
        ones follow each other; where N / S is no multiple of 16, in turn. Hits do not depend on it.
        """
        _check(origins, directions)
        per_origin = len(directions) // max(1, len(origins))
        if per_origin % _WIDTH:
            order = _NO_ORDER
        elif order is None:
            order = _counted(per_origin)
        elif len(order) != per_origin:
            raise ValueError(f"an order of {len(order)} is not that of {per_origin} rays of each origin")
        _intersect(
            self._handle,
            _ARGUMENTS,
            _contiguous(origins),
            _contiguous(directions),
            order,
            ranges,
            faces,
            normals,
        )

    def intersect_posed(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.floating],
        poses: NDArray[np.float64],
        sphere: tuple[float, float],
        farthest: float,
        ranges: NDArray[np.float32],
    ) -> None:
        """Shorten `ranges` (N, P), at most `farthest`, to the first hits of copies of the scene at `poses`.

        Rays have `origins` (N, 3) and unit `directions` (N, P, 3); those of row n meet the K copies at
        `poses` (N, K, 4): x, y, z and yaw. A sphere round (0, 0, `sphere[0]`) of radius `sphere[1]` holds the
        scene: only rays that pass it are traced.
        """
        order, whole = _counted(directions.shape[1]), (np.zeros((len(origins), 3)), np.inf)
        self._posed(origins, directions, order, poses, sphere, farthest, whole, ranges, _NO_HITS)

    def hit_posed(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.floating],
        order: NDArray[np.int64],
        poses: NDArray[np.float64],
        sphere: tuple[float, float],
        farthest: float,
        view: tuple[NDArray[np.float64], float],
        ranges: NDArray[np.float32],
    ) -> PosedHits:
        """As `intersect_posed`, and what the rays that a copy shortens have hit, in rising order of rays.

        The rays of a row lie within an angle [rad] of its axis: `view` has axes (N, 3) and the angle. They
        are traced in the `order` (P,) of their numbers.
        """
        rays = ranges.size
        found = PosedHits(
            np.empty(rays, np.int64),
            np.empty(rays, np.int32),
            np.empty(rays, np.int64),
            np.empty((rays, 3), np.float32),
        )
        count = self._posed(origins, directions, order, poses, sphere, farthest, view, ranges, found)
        return PosedHits(found.ray[:count], found.face[:count], found.copy[:count], found.normal[:count])

    def _posed(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.floating],
        order: NDArray[np.int64],
        poses: NDArray[np.float64],
        sphere: tuple[float, float],
        farthest: float,
        view: tuple[NDArray[np.float64], float],
        ranges: NDArray[np.float32],
        found: PosedHits,
    ) -> int:
        poses = np.ascontiguousarray(poses)
        turns = np.cos(poses[..., 3]), np.sin(poses[..., 3])
        bounds = (*sphere, farthest)
        count: int = _intersect_posed(
            self._handle,
            _ARGUMENTS,
            (origins, directions, order),
            (poses, *turns),
            bounds,
            view,
            ranges,
            tuple(found),
        )
        return count

    def occluded(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each ray hits any triangle, (N,)."""
        occluded = np.empty(len(directions), np.bool_)
        _check(origins, directions)
        _occluded(self._handle, _ARGUMENTS, _contiguous(origins), _contiguous(directions), occluded)
        return occluded


@lru_cache(maxsize=64)
def _counted(count: int) -> NDArray[np.int64]:
    return np.arange(count)


def _check(origins: NDArray[np.float32], directions: NDArray[np.float32]) -> None:
    # Compiled code would read beyond the arrays' ends.
    if len(directions) and (not len(origins) or len(directions) % len(origins)):
        raise ValueError(f"{len(directions)} rays do not divide evenly among {len(origins)} origins")


def _contiguous(values: NDArray[np.float32]) -> NDArray[np.float32]:
    # One memory layout, so that each function is compiled once.
    values = np.ascontiguousarray(values, np.float32)
    return values if values.flags.writeable else values.copy()


@compile_function
def _packet() -> Any:
    # Embree requires packets, and the mask of valid rays, at multiples of 64 bytes.
    room = np.empty((_ROWS + 2) * _WIDTH, np.uint32)
    start = (64 - room.ctypes.data % 64) // 4
    words = room[start : start + (_ROWS + 1) * _WIDTH].reshape(_ROWS + 1, _WIDTH)
    numbers = words.view(np.float32)
    for k in range(_WIDTH):
        numbers[_TNEAR, k] = 0.0
        numbers[_TIME, k] = 0.0
        words[_MASK, k] = _NONE
        words[_ID, k] = k
        words[_FLAGS, k] = 0
        words[_INSTANCE, k] = _NONE
        words[_ROWS, k] = _NONE
    return words, numbers


@compile_function
def _load(words: Any, numbers: Any, origins: Any, directions: Any, per_origin: int, first: int) -> int:
    # Copies up to 16 rays from index `first` into the packet; returns their number.
    count = min(_WIDTH, len(directions) - first)
    for k in range(_WIDTH):
        words[_ROWS, k] = _NONE if k < count else np.uint32(0)
    for k in range(count):
        ray = first + k
        origin = ray // per_origin
        for axis in range(3):
            numbers[axis, k] = origins[origin, axis]
            numbers[4 + axis, k] = directions[ray, axis]
    return count


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
    words, numbers = _packet()
    mask, packet = words[_ROWS:].ctypes.data, words.ctypes.data
    rays = np.empty(_WIDTH, np.int64)
    per_origin = len(directions) // max(1, len(origins))
    loaded = -1
    for first in range(0, len(directions), _WIDTH):
        count = min(_WIDTH, len(directions) - first)
        if len(order):
            # Packets are full and have one origin each, which is copied when it changes.
            origin = first // per_origin
            if origin != loaded:
                for axis in range(3):
                    for k in range(_WIDTH):
                        numbers[axis, k] = origins[origin, axis]
                loaded = origin
            before = origin * per_origin
            for k in range(_WIDTH):
                ray = before + order[first - before + k]
                rays[k] = ray
                for axis in range(3):
                    numbers[4 + axis, k] = directions[ray, axis]
        else:
            count = _load(words, numbers, origins, directions, per_origin, first)
            for k in range(count):
                rays[k] = first + k
        for k in range(count):
            numbers[_TFAR, k] = ranges[rays[k]]
            words[_GEOMETRY, k] = _NONE
        _intersect16(mask, scene, packet, arguments)
        for k in range(count):
            ranges[rays[k]] = numbers[_TFAR, k]
        if len(faces):
            for k in range(count):
                hit = words[_GEOMETRY, k] != _NONE
                faces[rays[k]] = np.int32(words[_FACE, k]) if hit else np.int32(-1)
        if len(normals):
            for k in range(count):
                hit = words[_GEOMETRY, k] != _NONE
                for axis in range(3):
                    normals[rays[k], axis] = numbers[_NORMAL + axis, k] if hit else np.float32(0.0)


@compile_function
def _intersect_posed(
    scene: int, arguments: int, rays: Any, copies: Any, bounds: Any, view: Any, ranges: Any, found: Any
) -> int:
    origins, directions, order = rays
    poses, cosines, sines = copies
    middle, radius, farthest = bounds
    axes, half_angle = view
    hit_rays, hit_faces, hit_copies, hit_normals = found
    words, numbers = _packet()
    mask, packet = words[_ROWS:].ctypes.data, words.ctypes.data
    loaded = np.empty(_WIDTH, np.int64)
    radius = radius * (1.0 + 1e-6) + 1e-6
    count_rays, hits = directions.shape[1], 0
    records = len(hit_rays) > 0
    # What the rays of a row have hit: face (-1 for none), copy and normal.
    faces = np.empty(count_rays if records else 0, np.int32)
    which = np.empty(len(faces), np.int64)
    normals = np.empty((len(faces), 3), np.float32)
    for row in range(len(origins)):
        is_near = False
        for copy in range(poses.shape[1]):
            dx, dy = origins[row, 0] - poses[row, copy, 0], origins[row, 1] - poses[row, copy, 1]
            dz = origins[row, 2] - poses[row, copy, 2]
            up = middle - dz
            away = dx * dx + dy * dy + up * up
            if away > (farthest + radius) ** 2:
                continue
            if away > radius * radius and half_angle < np.pi:
                distance = np.sqrt(away)
                ahead = (up * axes[row, 2] - dx * axes[row, 0] - dy * axes[row, 1]) / distance
                aside = np.arccos(min(max(ahead, -1.0), 1.0))
                if aside - np.arcsin(radius / distance) >= half_angle + 1e-6:
                    continue
            if records and not is_near:
                is_near = True
                for ray in range(count_rays):
                    faces[ray] = -1
            cos, sin = cosines[row, copy], sines[row, copy]
            for k in range(_WIDTH):
                numbers[0, k] = np.float32(cos * dx + sin * dy)
                numbers[1, k] = np.float32(cos * dy - sin * dx)
                numbers[2, k] = np.float32(dz)
            # From outside, a ray that passes the sphere goes at least as far along as its tangent.
            tangent = (away - radius * radius) * (1.0 - 1e-6)
            count = 0
            for place in range(count_rays + 1):
                if place < count_rays:
                    ray = order[place]
                    x, y, z = directions[row, ray, 0], directions[row, ray, 1], directions[row, ray, 2]
                    along = up * z - dx * x - dy * y
                    if tangent > 0.0 and (along <= 0.0 or along * along < tangent):
                        continue
                    numbers[4, count] = np.float32(cos * x + sin * y)
                    numbers[5, count] = np.float32(cos * y - sin * x)
                    numbers[6, count] = np.float32(z)
                    loaded[count] = ray
                    count += 1
                if count == _WIDTH or (place == count_rays and count > 0):
                    for k in range(_WIDTH):
                        words[_ROWS, k] = _NONE if k < count else np.uint32(0)
                    for k in range(count):
                        numbers[_TFAR, k] = ranges[row, loaded[k]]
                        words[_GEOMETRY, k] = _NONE
                    _intersect16(mask, scene, packet, arguments)
                    for k in range(count):
                        ray = loaded[k]
                        ranges[row, ray] = numbers[_TFAR, k]
                        if records and words[_GEOMETRY, k] != _NONE:
                            faces[ray] = np.int32(words[_FACE, k])
                            which[ray] = row * poses.shape[1] + copy
                            for axis in range(3):
                                normals[ray, axis] = numbers[_NORMAL + axis, k]
                    count = 0
        if is_near:
            for ray in range(count_rays):
                if faces[ray] >= 0:
                    hit_rays[hits] = row * count_rays + ray
                    hit_faces[hits] = faces[ray]
                    hit_copies[hits] = which[ray]
                    for axis in range(3):
                        hit_normals[hits, axis] = normals[ray, axis]
                    hits += 1
    return hits


@compile_function
def _occluded(scene: int, arguments: int, origins: Any, directions: Any, blocked: Any) -> None:
    words, numbers = _packet()
    per_origin = len(directions) // max(1, len(origins))
    for first in range(0, len(directions), _WIDTH):
        count = _load(words, numbers, origins, directions, per_origin, first)
        for k in range(count):
            numbers[_TFAR, k] = np.float32(np.inf)
        _occluded16(words[_ROWS:].ctypes.data, scene, words.ctypes.data, arguments)
        for k in range(count):
            # Embree marks an occluded ray by a negative range.
            blocked[first + k] = numbers[_TFAR, k] < 0.0
