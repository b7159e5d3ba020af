"""Serialisation of worlds: a tree of plain data, and flat arrays by dtype. Reading executes no code."""

from collections.abc import Mapping
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.settings import Settings
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_texture import MeshTexture
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.clearance import ClearanceField
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground_texture import GroundColours, GroundPicture
from dune_rl.worlds.importing.imported_props import ImportedProp
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.importing.surface_clearance import SurfaceClearance
from dune_rl.worlds.region_candidates import RegionCandidate
from dune_rl.worlds.surface_map import SurfaceMap
from dune_rl.worlds.surfaces import Soil, Surface
from dune_rl.worlds.world import Prop, World

Packed = tuple[dict[str, Any], dict[str, NDArray[Any]]]

# Only these classes are instantiated when a file names them. A new class that worlds refer to must be added
# here: until then, worlds with it cannot be cached.
_PLAIN: tuple[type, ...] = (
    ActorTrajectory,
    ClearanceField,
    Grass,
    GroundColours,
    GroundPicture,
    ImportedProp,
    ImportedWorld,
    Prop,
    MeshTexture,
    RegionCandidate,
    Soil,
    Surface,
    SurfaceClearance,
    SurfaceMap,
    World,
)
_SETTINGS: tuple[type[Settings], ...] = (LightConf,)
_ENUMS: tuple[type[Enum], ...] = (Segment,)
# Cached properties that are stored, because they take long to compute.
_STORED_PROPERTIES = ("clearance_field",)
# Attributes that are not part of a world's content.
_EXCLUDED = ("disk_cache",)
_TYPES = ("float64", "float32", "int64", "int32", "uint8", "bool")


class UnpackableError(ValueError):
    """A world refers to an object of a class that cannot be serialised."""


def pack(world: World) -> Packed:
    """A tree for JSON, and flat arrays by dtype name; raises `UnpackableError` for other classes."""
    packer = _Packer()
    root = packer.pack(world)
    arrays = {kind: np.concatenate(parts) for kind, parts in packer.parts.items()}
    return {"root": root, "objects": packer.objects}, arrays


def unpack(tree: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> World:
    """The inverse of `pack`; the world's arrays are views of `arrays`. Damaged input may raise any error."""
    world = _Unpacker(tree["objects"], arrays).unpack(tree["root"])
    if not isinstance(world, World):
        raise ValueError("the packed object is not a World")
    return world


def state_of(value: object) -> dict[str, Any]:
    """Attributes of `value` by name, without those that it computes from the others."""
    if isinstance(value, HeightField):
        return {"heights": value.heights, "spacing_m": value.spacing_m, "origin": value.origin}
    derived = {
        name
        for kind in type(value).__mro__
        for name, attribute in vars(kind).items()
        if isinstance(attribute, cached_property) and name not in _STORED_PROPERTIES
    }
    return {name: held for name, held in vars(value).items() if name not in {*derived, *_EXCLUDED}}


class _Packer:
    def __init__(self) -> None:
        self.objects: list[dict[str, Any]] = []
        self.parts: dict[str, list[NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}
        # Shared objects stay shared. References are held, so that no new object gets the same id.
        self._known: dict[int, tuple[object, Any]] = {}

    def pack(self, value: Any) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        if isinstance(value, _ENUMS):
            return {"enum": type(value).__name__, "value": value.value}
        if type(value) in (tuple, list):
            return {type(value).__name__: [self.pack(item) for item in value]}
        if id(value) not in self._known:
            self._known[id(value)] = (value, self._pack_once(value))
        return self._known[id(value)][1]

    def _pack_once(self, value: Any) -> Any:
        if type(value) is np.ndarray:
            return self._array(value)
        if type(value) in _SETTINGS:
            return {"settings": type(value).__name__, "values": value.model_dump(mode="json")}
        if type(value) is HeightField or type(value) in _PLAIN:
            state = [[name, self.pack(held)] for name, held in state_of(value).items()]
            self.objects.append({"class": type(value).__name__, "state": state})
            return {"object": len(self.objects) - 1}
        raise UnpackableError(
            f"{type(value).__name__} cannot be serialised by dune_rl.worlds.cache.serialization"
        )

    def _array(self, value: NDArray[Any]) -> dict[str, Any]:
        kind = value.dtype.name
        if kind not in _TYPES:
            raise UnpackableError(
                f"arrays of {kind} cannot be serialised by dune_rl.worlds.cache.serialization"
            )
        start = self._sizes.get(kind, 0)
        self._sizes[kind] = start + value.size
        self.parts.setdefault(kind, []).append(value.reshape(-1))
        return {"array": kind, "start": start, "shape": list(value.shape)}


class _Unpacker:
    def __init__(self, objects: list[dict[str, Any]], arrays: Mapping[str, NDArray[Any]]) -> None:
        self._objects, self._arrays = objects, arrays
        self._unpacked: dict[int, Any] = {}
        self._classes: dict[str, type] = {kind.__name__: kind for kind in _PLAIN}
        self._settings = {kind.__name__: kind for kind in _SETTINGS}
        self._enums = {kind.__name__: kind for kind in _ENUMS}

    def unpack(self, packed: Any) -> Any:
        if not isinstance(packed, dict):
            return packed
        if "array" in packed:
            start, shape = packed["start"], packed["shape"]
            return self._arrays[packed["array"]][start : start + int(np.prod(shape))].reshape(shape)
        if "object" in packed:
            number = packed["object"]
            if number not in self._unpacked:
                self._unpacked[number] = self._object(self._objects[number])
            return self._unpacked[number]
        if "enum" in packed:
            return self._enums[packed["enum"]](packed["value"])
        if "settings" in packed:
            return self._settings[packed["settings"]].model_validate(packed["values"])
        if "tuple" in packed:
            return tuple(self.unpack(item) for item in packed["tuple"])
        return [self.unpack(item) for item in packed["list"]]

    def _object(self, packed: dict[str, Any]) -> Any:
        state = {name: self.unpack(held) for name, held in packed["state"]}
        if packed["class"] == HeightField.__name__:
            return HeightField(**state)
        kind = self._classes[packed["class"]]
        value: Any = object.__new__(kind)
        vars(value).update(state)
        return value
