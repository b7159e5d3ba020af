"""The mesh world, built from a .dae, .obj, .stl, .ply or .glb file."""

from dataclasses import replace
from fnmatch import fnmatch
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, WorldFiles
from dune_rl.rendering.mesh_files.files import UpAxis, load_mesh_parts
from dune_rl.rendering.mesh_files.parts import MeshPart, has_usual_size
from dune_rl.worlds.importing.imported_world import (
    Friction,
    ImportedWorld,
    ImportedWorldConf,
    assemble_world,
    read_surfaces,
)

# Beyond this distance, single precision is coarser than a millimetre.
_FAR_M = 5_000.0


class MeshConf(ImportedWorldConf):
    """Settings of `build_mesh`."""

    name: Literal["mesh"] = "mesh"
    path: str = Field(min_length=1, description="the file; its textures are in its folder or below")
    unit_m: float | None = Field(
        default=None, gt=0.0, le=1e4, description="length of the file's unit; None: the file's, else a metre"
    )
    up: UpAxis | None = Field(default=None, description="the file's up axis; None: the file's, else z")
    ground: tuple[str, ...] = Field(
        default=(), description="names of the parts that are ground, with * as wildcard; none: determined"
    )
    friction: Friction = 1.0


def build_mesh(conf: MeshConf) -> ImportedWorld:
    """The world of a mesh file, split into ground and props; `WorldError` if that is impossible.

    Nothing outside the file's folder is read. Parts that are missing or not supported cause a `WorldWarning`.
    """
    path, report = conf.open()
    folder = WorldFiles(path.resolve().parent, path.resolve().parent)
    parts = load_mesh_parts(path, folder, report, unit_m=conf.unit_m, up=conf.up)
    parts = _move_near_origin(_declare_ground(parts, conf.ground), report)
    try:
        world = assemble_world(conf, parts, report, friction=conf.friction)
    except WorldError as error:
        raise report.explain(str(error)) from None
    if has_usual_size(world.extent):
        report.hints.pop("unit", None)
    for hint in report.hints.values():
        report.warn(hint)
    world.surfaces = read_surfaces(conf, world.extent)
    report.emit_warnings()
    return world


def _declare_ground(parts: list[MeshPart], patterns: tuple[str, ...]) -> list[MeshPart]:
    if not patterns:
        return parts
    matches = [any(fnmatch(part.name, pattern) for pattern in patterns) for part in parts]
    if not any(matches):
        names = ", ".join(sorted({part.name for part in parts})[:12])
        raise WorldError(f"world.ground={list(patterns)} names none of the file's parts; it has {names}.")
    return [replace(part, ground=is_ground) for part, is_ground in zip(parts, matches, strict=True)]


def _move_near_origin(parts: list[MeshPart], report: ImportReport) -> list[MeshPart]:
    """The parts, centred at the origin if they are very far from it."""
    low = np.min([part.vertices.min(axis=0) for part in parts], axis=0)
    high = np.max([part.vertices.max(axis=0) for part in parts], axis=0)
    middle = np.round((low + high) / 2)
    if np.abs(middle).max() < _FAR_M:
        return parts
    report.warn("is far from its origin and is moved there, by ({:g}, {:g}, {:g}) m".format(*-middle))
    matrix = np.eye(4)
    matrix[:3, 3] = -middle
    return [part.transform(matrix) for part in parts]
