"""Imported worlds: assembly of ground and props, clearance, and choice of the spawn region."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.errors import WorldError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.worlds.clearance import ClearanceField
from dune_rl.worlds.free_space import FreeSpace
from dune_rl.worlds.ground_texture import GroundColours, GroundPicture
from dune_rl.worlds.importing.ground_pictures import picture_from_colours
from dune_rl.worlds.importing.imported_props import ImportedProp, extract_props
from dune_rl.worlds.importing.mesh.ground import extract_ground
from dune_rl.worlds.importing.mesh_parts import GREY, MeshPart
from dune_rl.worlds.importing.surface_clearance import SurfaceClearance
from dune_rl.worlds.importing.untrusted_files import ImportReport
from dune_rl.worlds.world import Rectangle, World

Floats = NDArray[np.float32]

_REGION_M = 8.0
# The region is chosen for a robot of this size, since the world does not know its robots.
_ROBOT_RADIUS_M, _SLOPE_DEG, _EDGE_M = 0.6, 20.0, 1.5
_REGION_CELL_M = 0.25
# Score of a square: its free share, minus this times the distance from the middle in widths of the world.
_DISTANCE_COST = 0.4
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
            [(prop.vertices, prop.faces) for prop in solid if not prop.drivable],
            [(prop.vertices, prop.faces) for prop in solid if prop.drivable],
        )


def assemble_world(
    name: str,
    parts: Sequence[MeshPart],
    report: ImportReport,
    *,
    spacing_m: float | None,
    friction: float,
    region: Rectangle | None,
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
    world: ImportedWorld,
    region: Rectangle | None,
    report: ImportReport,
    known: NDArray[np.bool_] | None = None,
) -> ImportedWorld:
    """Set the world's region to `region`, or to the freest level square of up to 8 by 8 m.

    `known` (rows, columns) marks terrain points that were not filled in; None: all. Returns the world.
    """
    world.region = region if region is not None else find_free_region(world, report, known)
    return world


def check_region(region: Rectangle | None) -> Rectangle | None:
    """The same rectangle; `WorldError` if it has no area."""
    if region is not None and not (region[0] < region[1] and region[2] < region[3]):
        raise WorldError(f"world.region must be (xmin, xmax, ymin, ymax) with min < max, not {region}.")
    return region


def find_free_region(world: World, report: ImportReport, known: NDArray[np.bool_] | None = None) -> Rectangle:
    """The square of 8 m (less in a small world) with the most ground that a robot can occupy."""
    xmin, xmax, ymin, ymax = world.extent
    edge = min(_EDGE_M, 0.15 * min(xmax - xmin, ymax - ymin))
    free = FreeSpace(world, _ROBOT_RADIUS_M, _SLOPE_DEG, cell_m=_REGION_CELL_M, edge_m=edge)
    good = free.traversable
    if known is not None and not known.all():
        row = np.clip(np.round((free.y - ymin) / world.terrain.spacing_m).astype(int), 0, known.shape[0] - 1)
        column = np.clip(
            np.round((free.x - xmin) / world.terrain.spacing_m).astype(int), 0, known.shape[1] - 1
        )
        good &= known[np.ix_(row, column)]
    labels, count = ndimage.label(good)
    if not count:
        report.warn(
            f"no ground is level (under {_SLOPE_DEG:g} degrees) and free enough to start on; set world.region"
        )
        return world.extent
    part = labels == int(np.bincount(labels[labels > 0]).argmax())
    wide = min(_REGION_M, xmax - xmin - 2 * edge, ymax - ymin - 2 * edge)
    cells = max(1, min(int(wide / free.cell_m), *part.shape))
    share = _window_sums(part, cells)
    # Among squares of similar free share, one near the middle of the world.
    rows, columns = np.indices(share.shape).reshape(2, -1)
    x, y = free.x[columns] + wide / 2, free.y[rows] + wide / 2
    away = np.hypot((x - (xmin + xmax) / 2) / (xmax - xmin), (y - (ymin + ymax) / 2) / (ymax - ymin))
    best = int((share.reshape(-1) / share.max() - _DISTANCE_COST * away).argmax())
    left = float(free.x[columns[best]] - free.cell_m / 2)
    low = float(free.y[rows[best]] - free.cell_m / 2)
    return left, left + cells * free.cell_m, low, low + cells * free.cell_m


def _window_sums(grid: NDArray[np.bool_], size: int) -> NDArray[np.int64]:
    # Number of True cells in each square of `size`, indexed by its lowest row and column.
    total = np.zeros((grid.shape[0] + 1, grid.shape[1] + 1), np.int64)
    total[1:, 1:] = grid.cumsum(axis=0).cumsum(axis=1)
    return total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]


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
