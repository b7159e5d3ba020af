"""The Embree library: its functions, scenes, and packets of 16 rays in its layout, compiled.

The shared library is that of the embreex package. embreex itself casts single rays; this module binds the
packet functions, several times as fast. Memory layouts follow embree4/rtcore_ray.h and rtcore_common.h
(Embree 4).
"""

import ctypes
from typing import Any

import embreex.rtcore_scene
import llvmlite.binding
import numpy as np
from numba import types
from numpy.typing import NDArray

from dune_rl.geometry.compiled import compile_function

_ALL_FEATURES = 0xFFFFFFFF
_COHERENT = 1 << 16
_ROBUST = 1 << 2
_LOW_QUALITY = 0
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
_set_scene_quality = _function("rtcSetSceneBuildQuality", None, _pointer, ctypes.c_int)
_commit_scene = _function("rtcCommitScene", None, _pointer)
_new_geometry = _function("rtcNewGeometry", _pointer, _pointer, ctypes.c_int)
_set_geometry_quality = _function("rtcSetGeometryBuildQuality", None, _pointer, ctypes.c_int)
_commit_geometry = _function("rtcCommitGeometry", None, _pointer)
_release_geometry = _function("rtcReleaseGeometry", None, _pointer)
_attach_geometry = _function("rtcAttachGeometry", ctypes.c_uint, _pointer, _pointer)
_new_buffer = _function(
    "rtcSetNewGeometryBuffer",
    _pointer,
    *(_pointer, ctypes.c_int, ctypes.c_uint, ctypes.c_int, ctypes.c_size_t, ctypes.c_size_t),
)
release_scene = _function("rtcReleaseScene", None, _pointer)

_packet_function = types.void(types.intp, types.intp, types.intp, types.intp)
# Both take the addresses of a packet's mask, of the scene, of the packet, and of the arguments.
intersect16: Any = types.ExternalFunction("rtcIntersect16", _packet_function)
occluded16: Any = types.ExternalFunction("rtcOccluded16", _packet_function)


class _Arguments(ctypes.Structure):
    # RTCIntersectArguments; RTCOccludedArguments has the same layout. `room` is for fields of later versions.
    _fields_ = (
        ("flags", ctypes.c_uint),
        ("features", ctypes.c_uint),
        ("pointers", _pointer * 3),
        ("room", ctypes.c_uint * 8),
    )


_arguments = _Arguments(_COHERENT, _ALL_FEATURES)
ARGUMENTS = ctypes.addressof(_arguments)
_device: int | None = None


def _shared_device() -> int:
    # One device serves every scene of a process, since each device costs threads and memory.
    global _device
    if _device is None:
        _device = _new_device(b"threads=1,set_affinity=0")
        if not _device:
            raise RuntimeError("Embree could not be started on this machine")
    return _device


def build_scene(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, short_lived: bool = False
) -> int:
    """The address of a new scene of `vertices` (V, 3) and `faces` (F, 3), which `release_scene` frees.

    A `short_lived` one is built in a quarter of the time; rays take somewhat longer, and hit the same.
    """
    device = _shared_device()
    scene: int = _new_scene(device)
    # Without this flag, rays exactly along an edge pass between two triangles.
    _set_scene_flags(scene, _ROBUST)
    geometry = _new_geometry(device, _TRIANGLES)
    if short_lived:
        _set_scene_quality(scene, _LOW_QUALITY)
        _set_geometry_quality(geometry, _LOW_QUALITY)
    for slot, layout, values in ((_VERTICES, _FLOAT3, vertices), (_INDICES, _UINT3, faces)):
        kind = ctypes.c_float if slot == _VERTICES else ctypes.c_uint
        address = _new_buffer(geometry, slot, 0, layout, 12, len(values))
        buffer = ctypes.cast(address, ctypes.POINTER(kind))
        np.ctypeslib.as_array(buffer, (len(values), 3))[:] = values
    _commit_geometry(geometry)
    _attach_geometry(scene, geometry)
    _release_geometry(geometry)
    _commit_scene(scene)
    return scene


WIDTH = 16
# A packet has rows of 16 words: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask, id and flags 9-11;
# then the hit: normal 12-14, u and v 15-16, face 17, geometry 18, instance 19.
ROWS = 24
_TNEAR, _TIME, _MASK, _ID, _FLAGS = 3, 7, 9, 10, 11
DIRECTION, TFAR = 4, 8
NORMAL, FACE, GEOMETRY = 12, 17, 18
_INSTANCE = 19
NONE = np.uint32(0xFFFFFFFF)


@compile_function
def new_packet() -> Any:
    """A packet as words and as numbers, each (ROWS + 1, 16); its last row is the mask of valid rays."""
    # Embree requires packets, and the mask, at multiples of 64 bytes.
    room = np.empty((ROWS + 2) * WIDTH, np.uint32)
    start = (64 - room.ctypes.data % 64) // 4
    words = room[start : start + (ROWS + 1) * WIDTH].reshape(ROWS + 1, WIDTH)
    numbers = words.view(np.float32)
    for k in range(WIDTH):
        numbers[_TNEAR, k] = 0.0
        numbers[_TIME, k] = 0.0
        words[_MASK, k] = NONE
        words[_ID, k] = k
        words[_FLAGS, k] = 0
        words[_INSTANCE, k] = NONE
        words[ROWS, k] = NONE
    return words, numbers


@compile_function
def load_rays(words: Any, numbers: Any, origins: Any, directions: Any, per_origin: int, first: int) -> int:
    """Copy up to 16 rays from index `first` into the packet; returns their number."""
    count = min(WIDTH, len(directions) - first)
    for k in range(WIDTH):
        words[ROWS, k] = NONE if k < count else np.uint32(0)
    for k in range(count):
        ray = first + k
        origin = ray // per_origin
        for axis in range(3):
            numbers[axis, k] = origins[origin, axis]
            numbers[DIRECTION + axis, k] = directions[ray, axis]
    return count
