"""The Embree library: its functions and constants, the device, and the making of scenes.

The shared library is the one in the embreex package. embreex itself casts
single rays; this module binds the packet functions of the same library.
Memory layouts follow embree4/rtcore_ray.h and rtcore_common.h (Embree 4).
"""

import ctypes
from typing import Any

import embreex.rtcore_scene
import llvmlite.binding
import numpy as np
from numba import types
from numpy.typing import NDArray

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


def build_scene(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> int:
    """The address of a new scene of `vertices` (V, 3) and `faces` (F, 3), which `release_scene` frees."""
    device = _shared_device()
    scene: int = _new_scene(device)
    # Without this flag, rays exactly along an edge pass between two triangles.
    _set_scene_flags(scene, _ROBUST)
    geometry = _new_geometry(device, _TRIANGLES)
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
