"""Surface maps with natural patches: noise biased by slope and height."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.surface_map import CELL_M, MOST_CELLS, SurfaceMap
from dune_rl.worlds.surfaces import SURFACE_NAMES, SurfaceChoice, SurfaceName

_PATCH_M = 4.5
_SHARE_ROUNDS = 30


class SurfaceShare(NamedTuple):
    """A surface on a `share` of the ground, in patches biased to steep or high places.

    `steep` and `high` are standard deviations of noise per standard deviation of slope and of height.
    """

    name: SurfaceName
    share: float
    steep: float = 0.0
    high: float = 0.0


def surface_map(
    choice: SurfaceChoice, terrain: HeightField, seed: int, parts: Sequence[SurfaceShare], *, sinkage: bool
) -> SurfaceMap | None:
    """The surface map of `choice`: None for "uniform", a single surface, or "natural" patches of `parts`.

    Raises `WorldError` for `sinkage` without a map.
    """
    if choice == "uniform":
        if sinkage:
            raise WorldError(
                "world.sinkage=true needs a surface material: "
                f"set world.surfaces to natural, or to one of {', '.join(SURFACE_NAMES)}."
            )
        return None
    if choice != "natural":
        number = SURFACE_NAMES.index(choice)
        return SurfaceMap(np.full((1, 1), number, np.uint8), terrain.extent, sinkage=sinkage)
    return SurfaceMap(_patches(terrain, seed, parts), terrain.extent, sinkage=sinkage)


def _patches(terrain: HeightField, seed: int, parts: Sequence[SurfaceShare]) -> NDArray[np.uint8]:
    """Surface numbers (rows, columns); each surface covers its share of the ground."""
    xmin, xmax, ymin, ymax = terrain.extent
    columns, rows = (int(np.clip(round(side / CELL_M), 1, MOST_CELLS)) for side in (xmax - xmin, ymax - ymin))
    x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
    y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    slope, height = (
        _standardise(ndimage.gaussian_filter(field, 1.0 / CELL_M))
        for field in (terrain.slope(xy), terrain.height(xy))
    )
    rng = stream(seed, "surfaces")
    sigma = (_PATCH_M / 4 * rows / (ymax - ymin), _PATCH_M / 4 * columns / (xmax - xmin))
    fields = np.stack(
        [
            _standardise(ndimage.gaussian_filter(rng.standard_normal((rows, columns)), sigma, mode="wrap"))
            + part.steep * slope
            + part.high * height
            for part in parts
        ]
    )
    shares = np.array([part.share for part in parts])
    shares = shares / shares.sum()
    # Each cell gets the surface of the highest field. Offsets are adjusted until the shares match, on a
    # sixteenth of the cells.
    lift = np.zeros(len(parts))
    sample = fields[:, ::4, ::4].reshape(len(parts), -1)
    for _ in range(_SHARE_ROUNDS):
        winner = (sample + lift[:, None]).argmax(axis=0)
        lift += shares - np.bincount(winner, minlength=len(parts)) / sample.shape[1]
    numbers = np.array([SURFACE_NAMES.index(part.name) for part in parts], np.uint8)
    return numbers[(fields + lift[:, None, None]).argmax(axis=0)]


def _standardise(field: Array) -> Array:
    spread = field.std()
    # Level ground has no slopes to prefer.
    return (field - field.mean()) / spread if spread > 1e-9 else np.zeros_like(field)
