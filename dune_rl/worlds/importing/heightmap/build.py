"""A world from a map of heights: GeoTIFF (float64 too), PNG with 16 bits, or .npy."""

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from dune_rl.errors import WorldError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.importing.height_grid import MAX_POINTS, fill_gaps
from dune_rl.worlds.importing.heightmap.files import HeightSamples, read_heights
from dune_rl.worlds.importing.imported_world import ImportedWorld, check_region, set_region
from dune_rl.worlds.importing.surface_files import SurfaceFileConf, read_surfaces
from dune_rl.worlds.importing.untrusted_files import ImportReport, resolve_world_path
from dune_rl.worlds.world import Rectangle

Array = NDArray[np.float64]

_LARGEST_M = 20_000.0
# A file's own grid is kept up to here; a finer one must be asked for.
_OWN_POINTS = 400_000


class HeightmapConf(SurfaceFileConf):
    """Settings of `build_heightmap`. Row 0 of the map is its northern edge, at the greatest y."""

    name: Literal["heightmap"] = "heightmap"
    path: str = Field(min_length=1, description="the file: .tif, .tiff, .png or .npy")
    size_m: tuple[float, float] | None = Field(
        default=None, description="width along x and depth along y; None: as a GeoTIFF says"
    )
    relief_m: float | None = Field(
        default=None,
        gt=0.0,
        le=10_000.0,
        description="from the lowest to the highest; None: values are metres",
    )
    lowest_m: float | None = Field(
        default=None,
        ge=-20_000.0,
        le=20_000.0,
        description="height of the lowest point; None: 0 or as the file says",
    )
    spacing_m: float | None = Field(
        default=None,
        ge=0.01,
        le=100.0,
        description="of the grid; None: the file's, or one of 400,000 points where that has more",
    )
    friction: float = Field(default=1.0, gt=0.0, le=5.0)
    region: Rectangle | None = Field(
        default=None, description="xmin, xmax, ymin, ymax of the spawn region; None: the freest level square"
    )


def build_heightmap(conf: HeightmapConf) -> ImportedWorld:
    """The map as terrain, its middle at the origin; `WorldError` where the file or its size is unfit.

    Samples without a height are filled smoothly, which is a `WorldWarning`.
    """
    path = resolve_world_path(conf.path)
    report = ImportReport(path.name)
    heights = read_heights(path, report)
    size = _size(conf, heights, path)
    samples = _in_metres(conf, heights, path)
    terrain, known = terrain_from_samples(samples, size, conf.spacing_m, report)
    world = ImportedWorld("heightmap", terrain, (), region=terrain.extent, friction=conf.friction)
    set_region(world, check_region(conf.region), report, known)
    world.surfaces = read_surfaces(conf, world.extent)
    report.emit_warnings()
    return world


def terrain_from_samples(
    samples: Array, size_m: tuple[float, float], spacing_m: float | None, report: ImportReport
) -> tuple[HeightField, NDArray[np.bool_]]:
    """Terrain of samples (rows, columns; north first) [m] over `size_m` round the origin; where it is known.

    The outermost samples lie on the edges, as Gazebo has it. Where its samples are as far apart along x as
    along y and no other spacing is asked for, the grid is the file's own.
    """
    south_first = samples[::-1]
    known = np.isfinite(south_first)
    if not known.all():
        report.warn(f"{1.0 - known.mean():.1%} of its samples have no height; they are filled smoothly")
        south_first = fill_gaps(np.where(known, south_first, 0.0), known)
    rows, columns = south_first.shape
    width, depth = size_m
    step_x, step_y = width / (columns - 1), depth / (rows - 1)
    wanted = spacing_m
    if wanted is None:
        wanted = min(step_x, step_y)
        if (width / wanted + 1) * (depth / wanted + 1) > _OWN_POINTS:
            wanted = 1.02 * float(np.sqrt(width * depth / _OWN_POINTS))
    if (width / wanted + 1) * (depth / wanted + 1) > MAX_POINTS:
        least = 1.01 * float(np.sqrt(width * depth / MAX_POINTS))
        raise WorldError(
            f"world.spacing_m={wanted:g} makes more than {MAX_POINTS:,} points: "
            f"set it to {least:.2g} or more."
        )
    if min(width, depth) < wanted:
        raise WorldError(
            f"world.spacing_m={wanted:g} is more than the map's {min(width, depth):.2f} m: lower it."
        )
    origin = (-width / 2, -depth / 2)
    if abs(step_x / step_y - 1.0) < 1e-6 and abs(step_x / wanted - 1.0) < 1e-6:
        return HeightField(south_first, step_x, origin), known
    cells = np.maximum(np.floor(np.array([width, depth]) / wanted + 1e-6).astype(int), 1)
    start = -cells * wanted / 2
    x, y = (start[k] + wanted * np.arange(cells[k] + 1) for k in (0, 1))
    at = np.meshgrid((y + depth / 2) / step_y, (x + width / 2) / step_x, indexing="ij")
    if wanted > 1.5 * max(step_x, step_y):
        # Else fine relief would turn into noise of the coarse grid.
        # Of odd width, or it would shift the map.
        width_of = [2 * int(wanted / step / 2) + 1 for step in (step_y, step_x)]
        south_first = ndimage.uniform_filter(south_first, width_of, mode="nearest")
    heights = ndimage.map_coordinates(south_first, at, order=1, mode="nearest")
    near = ndimage.map_coordinates(known.astype(np.float64), at, order=0, mode="nearest") > 0.5
    return HeightField(heights, wanted, (float(start[0]), float(start[1]))), near


def _size(conf: HeightmapConf, heights: HeightSamples, path: Path) -> tuple[float, float]:
    rows, columns = heights.samples.shape
    if conf.size_m is not None:
        size = conf.size_m
    elif heights.pixel_m is not None:
        size = ((columns - 1) * heights.pixel_m[0], (rows - 1) * heights.pixel_m[1])
    else:
        raise WorldError(
            f"{path.name} does not say how large it is in metres: "
            "set world.size_m to its width and depth, such as [50, 50]."
        )
    if not all(1.0 <= side <= _LARGEST_M for side in size):
        raise WorldError(
            f"a map of {size[0]:g} by {size[1]:g} m is no world: "
            f"set world.size_m to 1 to {_LARGEST_M:g} m a side."
        )
    return size


def _in_metres(conf: HeightmapConf, heights: HeightSamples, path: Path) -> Array:
    samples = heights.samples
    low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
    if conf.relief_m is not None:
        # A picture's black and white are its range; of metric heights it is their own.
        zero, span = (low, high - low) if heights.metric else (0.0, 1.0)
        samples = (samples - zero) * (conf.relief_m / span if span > 0 else 0.0)
    elif not heights.metric:
        raise WorldError(
            f"{path.name} is a picture: set world.relief_m to the height [m] of white above black."
        )
    if conf.lowest_m is not None:
        samples = samples - float(np.nanmin(samples)) + conf.lowest_m
    return samples
