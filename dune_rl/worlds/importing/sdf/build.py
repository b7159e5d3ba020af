"""The sdf world, built from a Gazebo model or world."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, WorldFiles, resolve_world_path
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_files.parts import MeshPart, drop_faulty_triangles
from dune_rl.worlds.importing.grid_files import read_heights
from dune_rl.worlds.importing.ground import ImportedGround
from dune_rl.worlds.importing.height_grid import tile_picture
from dune_rl.worlds.importing.heightmap_world import terrain_from_samples
from dune_rl.worlds.importing.imported_props import extract_props, is_single_sheet
from dune_rl.worlds.importing.imported_world import (
    Friction,
    ImportedWorld,
    ImportedWorldConf,
    assemble_world,
    make_world,
    read_surfaces,
)
from dune_rl.worlds.importing.sdf.actors import place_on_ground
from dune_rl.worlds.importing.sdf.elements import SdfFileFinder, build_plane
from dune_rl.worlds.importing.sdf.reader import SdfContents, SdfHeightMap, SdfReader, mean_colour

_LEAST_FRICTION, _MOST_FRICTION = 0.01, 5.0
_PLANE_MARGIN_M, _SMALLEST_PLANE_M, _LARGEST_PLANE_M = 5.0, 20.0, 500.0
_TERRAIN_M, _TERRAIN_M2 = 15.0, 100.0


class SdfConf(ImportedWorldConf):
    """Settings of `build_sdf`."""

    name: Literal["sdf"] = "sdf"
    path: str = Field(min_length=1, description="an .sdf or .world file, or the folder of a model")
    friction: Friction | None = Field(
        default=None, description="None: that of the ground in the file, else 1"
    )


def build_sdf(conf: SdfConf) -> ImportedWorld:
    """The world of a Gazebo file: its collisions as ground and props, and visuals of links without these.

    Files are read only from the file's folder and from GZ_SIM_RESOURCE_PATH. What is missing or not supported
    causes a `WorldWarning`; raises `WorldError` if the file makes no world.
    """
    path, report = conf.open()
    contents = _read(path, report)
    parts = drop_faulty_triangles(contents.parts, report)
    # The hints are for single meshes: an SDF has <scale> and <pose> for that.
    report.hints.clear()
    friction = conf.friction if conf.friction is not None else _ground_friction(contents, parts, report)
    maps = contents.height_maps
    if len(maps) == 1 and np.allclose(maps[0].matrix[:3, :3], np.eye(3), atol=1e-6):
        world = _build_on_height_map(maps[0], parts, conf, friction, contents.light, report)
    else:
        if maps:
            parts += [_height_map_part(height_map, report) for height_map in maps]
        elif contents.planes:
            parts = _add_planes(contents, parts, report)
        if not parts:
            reason = (
                ", since all of it was left out:"
                if report.texts
                else ": it needs a plane, mesh or height map."
            )
            raise report.explain(f"{path} has nothing that a robot could stand on{reason}")
        try:
            world = assemble_world(conf, parts, report, friction=friction, light=contents.light)
        except WorldError as error:
            raise report.explain(str(error)) from None
    world.takes_smaller_friction = conf.friction is None
    world.surfaces = read_surfaces(conf, world.extent)
    world.trajectories = place_on_ground(contents.actors, world, report)
    report.emit_warnings()
    return world


def _read(path: Path, report: ImportReport, *, actors_only: bool = False) -> SdfContents:
    """The contents of a file, or of the model or world in a folder."""
    own = WorldFiles(path.resolve() if path.is_dir() else path.resolve().parent)
    finder = SdfFileFinder(own.root, report)
    file = finder.find_description(own.root, own) if path.is_dir() else path.resolve()
    return SdfReader(finder, report, actors_only=actors_only).read(file, own)


def count_actors(path: str) -> int:
    """Number of actors with trajectories in an SDF file; raises `WorldError` if it cannot be read."""
    found = resolve_world_path(path)
    return len(_read(found, ImportReport(found.name), actors_only=True).actors)


def _in_metres(height_map: SdfHeightMap, report: ImportReport) -> Array:
    """Samples (rows, columns) [m] relative to the map's pose, scaled as in Gazebo."""
    heights = read_heights(height_map.path, report)
    samples, top = heights.samples, float(height_map.size[2])
    if not heights.metric:
        return samples * top
    low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
    if low >= 0.0 and high > 0.0:
        # The largest height becomes the size along z.
        return samples * (top / high)
    # Below zero the range is scaled to the size along z, and the lowest height stays where it is.
    return low + (samples - low) * (top / max(high - low, 1e-9))


def _build_on_height_map(
    height_map: SdfHeightMap,
    parts: list[MeshPart],
    conf: SdfConf,
    friction: float,
    light: LightConf | None,
    report: ImportReport,
) -> ImportedWorld:
    # The terrain has the map's own grid, without resampling.
    flat, known = _terrain(height_map, conf.spacing_m, report)
    x, y, z = height_map.matrix[:3, 3]
    terrain = HeightField(flat.heights + z, flat.spacing_m, (flat.origin[0] + x, flat.origin[1] + y))
    colours, picture, shape = None, None, (*terrain.heights.shape, 3)
    if height_map.picture is not None:
        picture = tile_picture(terrain, height_map.picture, height_map.tile_m)
        colours = np.full(shape, picture.colours.mean(axis=(0, 1)), np.float32)
    elif height_map.colour is not None:
        colours = np.broadcast_to(np.array(height_map.colour, np.float32), shape)
    no_ground = np.zeros(sum(len(part.faces) for part in parts), bool)
    props = extract_props(parts, no_ground, terrain, report)
    ground = ImportedGround(terrain, known, colours, picture)
    return make_world(conf, ground, props, report, friction=friction, light=light)


def _terrain(
    height_map: SdfHeightMap, spacing_m: float | None, report: ImportReport
) -> tuple[HeightField, Flags]:
    size = (float(height_map.size[0]), float(height_map.size[1]))
    return terrain_from_samples(_in_metres(height_map, report), size, spacing_m, report)


def _height_map_part(height_map: SdfHeightMap, report: ImportReport) -> MeshPart:
    terrain, _ = _terrain(height_map, None, report)
    colour = height_map.colour
    if colour is None and height_map.picture is not None:
        report.warn("with several height maps, their textures are replaced by mean colours")
        colour = mean_colour(height_map.picture)
    return MeshPart.from_triangles("heightmap", *terrain.mesh(), colour, ground=True).transform(
        height_map.matrix
    )


def _add_planes(contents: SdfContents, parts: list[MeshPart], report: ImportReport) -> list[MeshPart]:
    """The parts and the planes. Planes are left out if a mesh is the terrain, which they would intersect."""
    terrain = next((part for part in parts if _is_terrain(part)), None)
    if terrain is not None:
        report.warn(f"its <plane> is left out, since the mesh {terrain.name!r} is the ground")
        return parts
    least = np.full(2, _SMALLEST_PLANE_M)
    if parts:
        reach = np.max([np.abs(part.vertices[:, :2]).max(axis=0) for part in parts], axis=0)
        least = np.clip(2 * (reach + _PLANE_MARGIN_M), _SMALLEST_PLANE_M, _LARGEST_PLANE_M)
    return [
        *parts,
        *(
            MeshPart.from_triangles("ground plane", *build_plane(shape, least), colour).transform(matrix)
            for shape, matrix, colour in contents.planes
        ),
    ]


def _is_terrain(part: MeshPart) -> bool:
    across = np.ptp(part.vertices[:, :2], axis=0)
    return part.solid and is_single_sheet(part) and across.min() > _TERRAIN_M and across.prod() > _TERRAIN_M2


def _ground_friction(contents: SdfContents, parts: list[MeshPart], report: ImportReport) -> float:
    """The ground's friction, with a warning if others differ, since a world has a single one."""
    frictions = contents.frictions
    if not frictions:
        return 1.0
    terrain = next((part.name for part in parts if part.ground or _is_terrain(part)), None)
    for name in ("heightmap", terrain, "plane"):
        if name in frictions:
            ground = frictions[name]
            break
    else:
        ground = float(np.median(list(frictions.values())))
    if len(set(frictions.values())) > 1:
        report.warn(f"has several frictions, but a world has only one: {ground:g} is used for all")
    if ground <= 0.0:
        report.warn(f"has a friction of {ground:g}; {_LEAST_FRICTION:g} is used")
    # The smaller coefficient of two acts: larger ones are alike.
    return min(max(ground, _LEAST_FRICTION), _MOST_FRICTION)
