"""The heightmap world, built from a GeoTIFF, PNG or .npy file of heights."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy import ndimage

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.importing.grid_files import HeightSamples, read_heights
from dune_rl.worlds.importing.ground import ImportedGround
from dune_rl.worlds.importing.height_grid import check_grid_size, fill_gaps, grid_axes
from dune_rl.worlds.importing.imported_world import (
    Friction,
    ImportedWorld,
    ImportedWorldConf,
    SpacingM,
    make_world,
    read_surfaces,
)

_LARGEST_M = 20_000.0
# Up to this number of points, the file's own grid is the default.
_OWN_POINTS = 400_000


class HeightmapConf(ImportedWorldConf):
    """Settings of `build_heightmap`. Row 0 of the map is its northern edge, at the largest y."""

    name: Literal["heightmap"] = "heightmap"
    path: str = Field(min_length=1, description="the file: .tif, .tiff, .png or .npy")
    size_m: tuple[float, float] | None = Field(
        default=None, description="width along x and depth along y; None: those of a GeoTIFF"
    )
    relief_m: Annotated[float, Field(gt=0.0, le=10_000.0)] | None = Field(
        default=None, description="height difference from lowest to highest; None: values are metres"
    )
    lowest_m: Annotated[float, Field(ge=-20_000.0, le=20_000.0)] | None = Field(
        default=None, description="height of the lowest point; None: 0, or that of the file"
    )
    spacing_m: SpacingM | None = Field(
        default=None,
        description="of the grid; None: the file's, or one of 400,000 points where that has more",
    )
    friction: Friction = 1.0


def build_heightmap(conf: HeightmapConf) -> ImportedWorld:
    """The map as terrain, centred at the origin; `WorldError` if the file or its size is invalid.

    Samples without a height are filled smoothly, with a `WorldWarning`.
    """
    path, report = conf.open()
    heights = read_heights(path, report)
    size, samples = _size(conf, heights, path), _in_metres(conf, heights, path)
    terrain, known = terrain_from_samples(samples, size, conf.spacing_m, report)
    world = make_world(conf, ImportedGround(terrain, known), (), report, friction=conf.friction)
    world.surfaces = read_surfaces(conf, world.extent)
    report.emit_warnings()
    return world


def terrain_from_samples(
    samples: Array, size_m: tuple[float, float], spacing_m: float | None, report: ImportReport
) -> tuple[HeightField, Flags]:
    """Terrain of `samples` (rows, columns) [m], north first, over `size_m` around the origin.

    Also returns a mask (rows, columns) of the grid's points with known heights. The outermost samples are on
    the edges, as in Gazebo. If samples are equally spaced along x and y and no other spacing is given, the
    grid is the file's own.
    """
    south_first = samples[::-1]
    known = np.isfinite(south_first)
    if not known.all():
        report.warn(f"{1.0 - known.mean():.1%} of its samples have no height; they are filled smoothly")
        south_first = fill_gaps(np.where(known, south_first, 0.0), known)
    rows, columns = south_first.shape
    width, depth = size_m
    step_x, step_y = width / (columns - 1), depth / (rows - 1)
    spacing = spacing_m
    if spacing is None:
        spacing = min(step_x, step_y)
        if (width / spacing + 1) * (depth / spacing + 1) > _OWN_POINTS:
            spacing = 1.02 * float(np.sqrt(width * depth / _OWN_POINTS))
    check_grid_size(width, depth, spacing, "map")
    origin = (-width / 2, -depth / 2)
    if abs(step_x / step_y - 1.0) < 1e-6 and abs(step_x / spacing - 1.0) < 1e-6:
        return HeightField(south_first, step_x, origin), known
    x, y, start = grid_axes(np.array(origin), -np.array(origin), spacing)
    at = np.meshgrid((y + depth / 2) / step_y, (x + width / 2) / step_x, indexing="ij")
    if spacing > 1.5 * max(step_x, step_y):
        # Low-pass filter against aliasing; of odd width, since an even one would shift the map.
        filter_size = [2 * int(spacing / step / 2) + 1 for step in (step_y, step_x)]
        south_first = ndimage.uniform_filter(south_first, filter_size, mode="nearest")
    heights = ndimage.map_coordinates(south_first, at, order=1, mode="nearest")
    has_height = ndimage.map_coordinates(known.astype(np.float64), at, order=0, mode="nearest") > 0.5
    return HeightField(heights, spacing, start), has_height


def _size(conf: HeightmapConf, heights: HeightSamples, path: Path) -> tuple[float, float]:
    rows, columns = heights.samples.shape
    if conf.size_m is not None:
        size = conf.size_m
    elif heights.pixel_m is not None:
        size = ((columns - 1) * heights.pixel_m[0], (rows - 1) * heights.pixel_m[1])
    else:
        raise WorldError(
            f"{path.name} does not contain its size in metres: "
            "set world.size_m to its width and depth, such as [50, 50]."
        )
    if not all(1.0 <= side <= _LARGEST_M for side in size):
        raise WorldError(
            f"a map of {size[0]:g} by {size[1]:g} m cannot be a world: "
            f"set world.size_m to 1 to {_LARGEST_M:g} m per side."
        )
    return size


def _in_metres(conf: HeightmapConf, heights: HeightSamples, path: Path) -> Array:
    samples = heights.samples
    low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
    if conf.relief_m is not None:
        # The range of an image is black to white, that of metric heights lowest to highest.
        zero, span = (low, high - low) if heights.metric else (0.0, 1.0)
        samples = (samples - zero) * (conf.relief_m / span if span > 0 else 0.0)
    elif not heights.metric:
        raise WorldError(
            f"{path.name} is an image: set world.relief_m to the height [m] of white above black."
        )
    if conf.lowest_m is not None:
        samples = samples - float(np.nanmin(samples)) + conf.lowest_m
    return samples
