"""Imported worlds: assembly of ground and props, clearance, and choice of the spawn region."""

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport
from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_files.parts import GREY, MeshPart
from dune_rl.worlds.clearance import ClearanceField, SurfaceClearance
from dune_rl.worlds.ground_texture import GroundColours, GroundPicture
from dune_rl.worlds.importing.ground import extract_ground
from dune_rl.worlds.importing.ground_pictures import picture_from_colours
from dune_rl.worlds.importing.imported_props import ImportedProp, extract_props
from dune_rl.worlds.importing.region_search import find_region_candidates
from dune_rl.worlds.world import Rectangle, World

# Settings of the region: a rectangle, the number of a candidate, or None for the first candidate.
RegionChoice = Rectangle | Annotated[int, Field(ge=1, le=99)] | None
REGION_TEXT = (
    "of starts and goals: xmin, xmax, ymin, ymax, or the number of a region on the world's map; "
    "None: the first, which is between the objects if there is room"
)
# Colours that differ by less count as equal.
_EQUAL_COLOURS = 0.02


class ImportedWorld(World):
    """A world from a file.

    `ground_colours` (rows, columns, 3) are the ground's colours (sRGB) at the points of its grid, None if the
    file has none; `picture` has more detail than these; `light` is the file's sun, None if it has none.
    """

    def __init__(
        self,
        name: str,
        terrain: HeightField,
        props: Sequence[ImportedProp],
        *,
        region: Rectangle,
        friction: float = 1.0,
        ground_colours: Floats | None = None,
        picture: GroundPicture | None = None,
        light: LightConf | None = None,
    ) -> None:
        if (
            picture is None
            and ground_colours is not None
            and np.ptp(ground_colours, axis=(0, 1)).max() > _EQUAL_COLOURS
        ):
            picture = picture_from_colours(terrain, ground_colours)
        super().__init__(
            name,
            terrain,
            props,
            region=region,
            friction=friction,
            ground=_mean_ground_colours(ground_colours),
            picture=picture,
            light=light,
        )
        self.ground_colours = ground_colours

    @cached_property
    def clearance_field(self) -> ClearanceField:
        """The distance field that `clearance` interpolates (`SurfaceClearance`)."""
        solid = [prop for prop in self.props if prop.solid]
        return SurfaceClearance(
            self.terrain,
            [prop.mesh for prop in solid if not prop.drivable],
            [prop.mesh for prop in solid if prop.drivable],
        )


def assemble_world(
    name: str,
    parts: Sequence[MeshPart],
    report: ImportReport,
    *,
    spacing_m: float | None,
    friction: float,
    region: RegionChoice,
    light: LightConf | None = None,
) -> ImportedWorld:
    """The world of `parts`, split into ground and props; without a `region`, one is chosen."""
    ground = extract_ground(parts, spacing_m, report)
    props = extract_props(parts, ground.faces, ground.terrain, report)
    return set_region(
        ImportedWorld(
            name,
            ground.terrain,
            props,
            region=ground.terrain.extent,
            friction=friction,
            ground_colours=ground.colours,
            picture=ground.picture,
            light=light,
        ),
        region,
        report,
        ground.known,
    )


def set_region(
    world: ImportedWorld, region: RegionChoice, report: ImportReport, known: Flags | None = None
) -> ImportedWorld:
    """Set the world's region to a rectangle, or to the candidate of this number; None: the first one.

    `known` (rows, columns) marks terrain points that were not filled in; None: all. Returns the world. Raises
    `WorldError` if there is no candidate of that number.
    """
    if isinstance(region, tuple):
        world.region = region
        return world
    world.region_candidates = tuple(find_region_candidates(world, known))
    count = len(world.region_candidates)
    if region is not None and region > count:
        regions = f"regions 1 to {count}" if count else "no region"
        raise WorldError(
            f"world.region={region}: {report.source} has {regions} to choose from, as view=map shows; a "
            "rectangle [xmin, xmax, ymin, ymax] is another way."
        )
    if count:
        world.region = world.region_candidates[(region or 1) - 1].rectangle
    else:
        report.warn("no ground is level (under 20 degrees) and free enough to start on; set world.region")
        world.region = world.extent
    return world


def check_region(region: RegionChoice) -> RegionChoice:
    """The same choice; `WorldError` if it is a rectangle without an area."""
    if isinstance(region, tuple) and not (region[0] < region[1] and region[2] < region[3]):
        raise WorldError(f"world.region must be (xmin, xmax, ymin, ymax) with min < max, not {region}.")
    return region


def _mean_ground_colours(colours: Floats | None) -> GroundColours:
    """Ground colours around the mean of `colours`, darker and lighter in patches."""
    mean = np.array(GREY) if colours is None else colours.reshape(-1, 3).mean(axis=0)
    if np.allclose(mean, GREY, atol=0.02):
        # The colour is unknown: dry earth.
        mean = np.array([0.58, 0.48, 0.37])

    def scaled(factor: float) -> tuple[float, float, float]:
        red, green, blue = np.clip(mean * factor, 0.0, 1.0)
        return float(red), float(green), float(blue)

    return GroundColours(
        low=scaled(0.9), high=scaled(1.1), bare=scaled(0.8), bare_from_rad=0.45, contrast=0.8
    )
