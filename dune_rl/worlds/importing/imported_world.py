"""Imported worlds: their common settings, assembly of ground and props, spawn region and surface map."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, resolve_world_path
from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_files.parts import GREY, MeshPart
from dune_rl.worlds.clearance import SurfaceClearance
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.importing.grid_files import SURFACE_FORMATS, read_surface_numbers
from dune_rl.worlds.importing.ground import ImportedGround, extract_ground
from dune_rl.worlds.importing.height_grid import picture_from_colours
from dune_rl.worlds.importing.imported_props import extract_props
from dune_rl.worlds.importing.region_search import find_region_candidates
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.surfaces import SURFACE_NAMES, SurfaceMap, SurfaceName
from dune_rl.worlds.world import Prop, Rectangle, World

# Colours that differ by less count as equal.
_EQUAL_COLOURS = 0.02

SpacingM = Annotated[float, Field(ge=0.01, le=100.0)]
Friction = Annotated[float, Field(gt=0.0, le=5.0)]


class ImportedWorldConf(WorldSettings):
    """File of an imported world, its region of starts and goals, and the surface materials of its ground."""

    disk_cached = "world"
    path: str
    spacing_m: SpacingM | None = Field(
        default=None, description="of the ground's grid; None: chosen for its size"
    )
    region: Rectangle | Annotated[int, Field(ge=1, le=99)] | None = Field(
        default=None,
        description="of starts and goals: xmin, xmax, ymin, ymax, or the number of a region on the world's "
        "map; None: the first, which is between the objects if there is room",
    )
    surface_map: str | None = Field(
        default=None,
        min_length=1,
        description="a surface's name, or a .png or .npy file of surface numbers over the ground, "
        "first row north; None: uniform friction",
    )
    surface_legend: tuple[SurfaceName, ...] = Field(
        default=SURFACE_NAMES, min_length=1, description="surfaces of the numbers 0, 1, ..."
    )
    sinkage: bool = Field(default=False, description="wheels sink in soft surfaces")

    def open(self) -> tuple[Path, ImportReport]:
        """The path of the file, and a report of its import; `WorldError` for a region without an area."""
        region = self.region
        if isinstance(region, tuple) and not (region[0] < region[1] and region[2] < region[3]):
            raise WorldError(f"world.region must be (xmin, xmax, ymin, ymax) with min < max, not {region}.")
        path = resolve_world_path(self.path)
        return path, ImportReport(path.name)


class ImportedWorld(World):
    """A world from a file, whose meshes may be thinner than a cell or have coincident faces."""

    _clearance_class = SurfaceClearance


def make_world(
    conf: ImportedWorldConf,
    ground: ImportedGround,
    props: Sequence[Prop],
    report: ImportReport,
    *,
    friction: float,
    light: LightConf | None = None,
) -> ImportedWorld:
    """The world of `conf` with its region; `light` is the file's sun."""
    terrain, colours, picture = ground.terrain, ground.colours, ground.picture
    if picture is None and colours is not None and np.ptp(colours, axis=(0, 1)).max() > _EQUAL_COLOURS:
        picture = picture_from_colours(terrain, colours)
    look: Any = {"ground": _mean_ground_colours(colours), "picture": picture, "light": light}
    world = ImportedWorld(conf.name, terrain, props, region=terrain.extent, friction=friction, **look)
    _set_region(world, conf, report, ground.known)
    return world


def assemble_world(
    conf: ImportedWorldConf,
    parts: Sequence[MeshPart],
    report: ImportReport,
    *,
    friction: float,
    light: LightConf | None = None,
) -> ImportedWorld:
    """The world of `parts`, split into ground and props."""
    ground, is_ground = extract_ground(parts, conf.spacing_m, report)
    props = extract_props(parts, is_ground, ground.terrain, report)
    return make_world(conf, ground, props, report, friction=friction, light=light)


def _set_region(
    world: ImportedWorld, conf: ImportedWorldConf, report: ImportReport, known: Flags | None
) -> None:
    if isinstance(conf.region, tuple):
        world.region = conf.region
        return
    world.region_candidates = tuple(find_region_candidates(world, known))
    count = len(world.region_candidates)
    if conf.region is not None and conf.region > count:
        regions = f"regions 1 to {count}" if count else "no region"
        raise WorldError(
            f"world.region={conf.region}: {report.source} has {regions} to choose from, as view=map shows; a "
            "rectangle [xmin, xmax, ymin, ymax] is another way."
        )
    if count:
        world.region = world.region_candidates[(conf.region or 1) - 1].rectangle
    else:
        report.warn("no ground is level (under 20 degrees) and free enough to start on; set world.region")


def read_surfaces(conf: ImportedWorldConf, extent: Rectangle) -> SurfaceMap | None:
    """The surface map over `extent`, None if there is none; `WorldError` if it cannot be read."""
    name, known = conf.surface_map, ", ".join(SURFACE_NAMES)
    if name is None:
        if conf.sinkage:
            raise WorldError(
                "world.sinkage=true needs a surface material: "
                f"set world.surface_map to a file, or to one of {known}."
            )
        return None
    if name in SURFACE_NAMES:
        return SurfaceMap(np.array([[SURFACE_NAMES.index(name)]]), extent, sinkage=conf.sinkage)
    path = Path(name).expanduser()
    is_map = path.suffix.lower() in SURFACE_FORMATS
    if not is_map or not path.exists():
        fault = "there is no such file" if is_map else "it is neither"
        raise WorldError(
            f"world.surface_map={name} must be one of {known}, "
            f"or a file that ends in {' or '.join(SURFACE_FORMATS)}: {fault}."
        )
    numbers = read_surface_numbers(path)
    unknown = np.setdiff1d(numbers, np.arange(len(conf.surface_legend)))
    if len(unknown):
        raise WorldError(
            f"world.surface_map={name} has the number {unknown[0]}, and world.surface_legend "
            f"names the numbers 0 to {len(conf.surface_legend) - 1} ({', '.join(conf.surface_legend)}): "
            "add names, or change the file."
        )
    meaning = np.array([SURFACE_NAMES.index(each) for each in conf.surface_legend], np.uint8)
    # The first row of the file is north, that of the map south.
    return SurfaceMap(meaning[numbers[::-1]], extent, sinkage=conf.sinkage)


def _mean_ground_colours(colours: Floats | None) -> GroundColours:
    """Ground colours around the mean of `colours`, darker and lighter in patches."""
    mean = np.array(GREY) if colours is None else colours.reshape(-1, 3).mean(axis=0)
    if np.allclose(mean, GREY, atol=0.02):
        # The colour is unknown: dry earth.
        mean = np.array([0.58, 0.48, 0.37])
    low, high, bare = (tuple(np.clip(mean * factor, 0.0, 1.0).tolist()) for factor in (0.9, 1.1, 0.8))
    return GroundColours(low, high, bare, bare_from_rad=0.45, contrast=0.8)
