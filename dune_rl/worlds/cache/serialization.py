"""Serialisation of worlds: a tree of plain data, and flat arrays by dtype. Reading executes no code."""

from collections.abc import Mapping
from functools import cached_property
from inspect import getmembers_static
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_texture import MeshTexture
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.clearance import ClearanceField, SurfaceClearance
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground_texture import GroundColours, GroundPicture
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.surfaces import Soil, Surface, SurfaceMap
from dune_rl.worlds.world import Prop, RegionCandidate, World

# The classes that are instantiated when an entry names them. A new class that worlds refer to must be added
# here: until then, worlds with it cannot be cached.
_PLAIN: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        ActorTrajectory,
        ClearanceField,
        Grass,
        GroundColours,
        GroundPicture,
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
}
# Cached properties that are stored, because they take long to compute.
_STORED_PROPERTIES = {"clearance_field"}
# Attributes that are not part of a world's content.
_EXCLUDED = {"disk_cache"}
_TYPES = ("float64", "float32", "int64", "int32", "uint8", "bool")


class SerializationError(ValueError):
    """A world refers to an object of a class that cannot be serialised."""


def serialize_world(world: World) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """A tree for JSON, and flat arrays by dtype name; raises `SerializationError` for other classes."""
    writer = _Writer()
    root = writer.write(world)
    arrays = {kind: np.concatenate(parts) for kind, parts in writer.parts.items()}
    return {"root": root, "objects": writer.objects}, arrays


def deserialize_world(tree: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> World:
    """The inverse of `serialize_world`; the world's arrays are views of `arrays`.

    Damaged input may raise any error.
    """
    world = _Reader(tree["objects"], arrays).read(tree["root"])
    if not isinstance(world, World):
        raise ValueError("the object is not a World")
    return world


def state_of(value: object) -> dict[str, Any]:
    """Attributes of `value` by name, without those that it computes from the others."""
    if isinstance(value, HeightField):
        return {"heights": value.heights, "spacing_m": value.spacing_m, "origin": value.origin}
    derived = {
        name for name, of in getmembers_static(type(value)) if isinstance(of, cached_property)
    } - _STORED_PROPERTIES
    return {name: held for name, held in vars(value).items() if name not in derived | _EXCLUDED}


class _Writer:
    def __init__(self) -> None:
        self.objects: list[dict[str, Any]] = []
        self.parts: dict[str, list[NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}
        # Shared objects stay shared. References are held, so that no new object gets the same id.
        self._known: dict[int, tuple[object, Any]] = {}

    def write(self, value: Any) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        if isinstance(value, Segment):
            return {"segment": value.value}
        if type(value) in (tuple, list):
            return {type(value).__name__: [self.write(item) for item in value]}
        if id(value) not in self._known:
            self._known[id(value)] = (value, self._write_once(value))
        return self._known[id(value)][1]

    def _write_once(self, value: Any) -> Any:
        kind = type(value)
        if kind is np.ndarray and value.dtype.name in _TYPES:
            dtype = value.dtype.name
            start = self._sizes.get(dtype, 0)
            self._sizes[dtype] = start + value.size
            self.parts.setdefault(dtype, []).append(value.reshape(-1))
            return {"array": dtype, "start": start, "shape": list(value.shape)}
        if kind is LightConf:
            return {"light": value.model_dump(mode="json")}
        if kind is HeightField or _PLAIN.get(kind.__name__) is kind:
            state = [[name, self.write(held)] for name, held in state_of(value).items()]
            self.objects.append({"class": kind.__name__, "state": state})
            return {"object": len(self.objects) - 1}
        name = f"arrays of {value.dtype.name}" if kind is np.ndarray else kind.__name__
        raise SerializationError(f"{name} cannot be serialised by {__name__}")


class _Reader:
    def __init__(self, objects: list[dict[str, Any]], arrays: Mapping[str, NDArray[Any]]) -> None:
        self._objects, self._arrays = objects, arrays
        self._known: dict[int, Any] = {}

    def read(self, written: Any) -> Any:
        match written:
            case {"array": dtype, "start": start, "shape": shape}:
                return self._arrays[dtype][start : start + int(np.prod(shape))].reshape(shape)
            case {"object": number}:
                if number not in self._known:
                    self._known[number] = self._read_object(self._objects[number])
                return self._known[number]
            case {"segment": value}:
                return Segment(value)
            case {"light": values}:
                return LightConf.model_validate(values)
            case {"tuple": items}:
                return tuple(self.read(item) for item in items)
            case {"list": items}:
                return [self.read(item) for item in items]
            case _:
                return written

    def _read_object(self, written: dict[str, Any]) -> Any:
        state = {name: self.read(held) for name, held in written["state"]}
        if written["class"] == HeightField.__name__:
            return HeightField(**state)
        value: Any = object.__new__(_PLAIN[written["class"]])
        vars(value).update(state)
        return value
