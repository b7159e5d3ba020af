"""Maps of ground materials over the terrain, and drivable decks above it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.surfaces import SURFACE_NAMES, SURFACES, Surface, SurfaceChoice, SurfaceName

Numbers = NDArray[np.uint8]
Rectangle = tuple[float, float, float, float]

CELL_M = 0.1
MOST_CELLS = 1024
# A wheel is on a deck if its lowest point is at most this far below the deck's top.
_ON_DECK_M = 0.1
_CAST_M = 1.0
_PATCH_M = 4.5
_SHARE_ROUNDS = 30


class SurfaceMap:
    """Grid of materials over the terrain: `numbers` (rows, columns) are indices into `surfaces`.

    The cells divide `extent` (xmin, xmax, ymin, ymax) [m] evenly; the first
    cell is at the lowest x and y. With `sinkage`, wheels sink into soils.
    """

    def __init__(
        self,
        numbers: ArrayLike,
        extent: Rectangle,
        surfaces: Sequence[Surface] = SURFACES,
        *,
        sinkage: bool = False,
    ) -> None:
        grid = np.array(numbers)
        if grid.ndim != 2 or not grid.size or grid.dtype.kind not in "iu":
            raise ValueError(f"numbers must be a grid of whole numbers, not {grid.dtype} of {grid.shape}")
        low, high = grid.min(), grid.max()
        if low < 0 or high >= min(len(surfaces), 256):
            raise ValueError(f"numbers are from {low} to {high}, but there are {len(surfaces)} surfaces")
        self.numbers: Numbers = grid.astype(np.uint8)
        self.numbers.flags.writeable = False
        self.extent = extent
        self.surfaces = tuple(surfaces)
        self.sinkage = sinkage
        xmin, xmax, ymin, ymax = extent
        sides = np.array(grid.shape[::-1])
        self._low, self._per_m = np.array([xmin, ymin]), sides / np.array([xmax - xmin, ymax - ymin])
        self._last, self._flat = sides - 1, self.numbers.ravel()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the surfaces, ordered by their numbers."""
        return tuple(surface.name for surface in self.surfaces)

    def number(self, name: str) -> int:
        """The number of the surface named `name`; `ValueError` if there is none."""
        if name not in self.names:
            raise ValueError(f"the map has no surface {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def at(self, xy: ArrayLike) -> Numbers:
        """Surface numbers (...) at points (..., 2); outside the map, those of its edge."""
        cell = ((np.asarray(xy, np.float64) - self._low) * self._per_m).astype(np.intp)
        np.clip(cell, 0, self._last, out=cell)
        return self._flat[cell[..., 1] * (self._last[0] + 1) + cell[..., 0]]


class Deck(NamedTuple):
    """Mesh of a drivable prop, (V, 3) [m] and (F, 3), and its surface number (None: that of the ground)."""

    vertices: Array
    faces: NDArray[np.int32]
    number: int | None


class Decks:
    """Height and surface number of the topmost deck over `terrain`, on a grid.

    A deck without a number has that of the `ground` below it.
    """

    def __init__(self, decks: Sequence[Deck], terrain: HeightField, ground: SurfaceMap) -> None:
        low = np.min([deck.vertices.min(axis=0) for deck in decks], axis=0)
        high = np.max([deck.vertices.max(axis=0) for deck in decks], axis=0)
        size = np.clip(np.ceil((high - low)[:2] / CELL_M), 1, MOST_CELLS).astype(int)
        self._low, self._per_m, self._last = low[:2], size / np.maximum(high - low, 1e-9)[:2], size - 1
        x, y = (low[k] + (np.arange(size[k]) + 0.5) * (high - low)[k] / size[k] for k in (0, 1))
        xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        top = terrain.height(xy)
        bare = top.copy()
        numbers = ground.at(xy)
        ceiling = float(high[2]) + _CAST_M
        for deck in decks:
            first, last = deck.vertices[:, :2].min(axis=0), deck.vertices[:, :2].max(axis=0)
            near = np.flatnonzero(((xy >= first) & (xy <= last)).all(axis=1))
            if not len(near):
                continue
            origins = np.column_stack([xy[near], np.full(len(near), ceiling)]).astype(np.float32)
            down = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(near), 1))
            reach = np.full(len(near), high[2] - low[2] + 2 * _CAST_M, np.float32)
            is_hit = RayScene(deck.vertices, deck.faces).hit_faces(origins, down, reach) >= 0
            height = ceiling - reach.astype(np.float64)
            above = is_hit & (height > top[near])
            top[near[above]] = height[above]
            if deck.number is not None:
                numbers[near[above]] = deck.number
        # Parts of a stone below the ground carry no wheel.
        self._top, self._numbers = np.where(top > bare, top, np.inf), numbers

    def surface_below(self, points_w: Array) -> tuple[Flags, Numbers, Array]:
        """Whether points (..., 3) are on a deck, and its surface number and height [m] there, each (...)."""
        cell = np.floor((points_w[..., :2] - self._low) * self._per_m).astype(np.intp)
        inside = ((cell >= 0) & (cell <= self._last)).all(axis=-1)
        np.clip(cell, 0, self._last, out=cell)
        index = cell[..., 1] * (self._last[0] + 1) + cell[..., 0]
        top = self._top[index]
        on = inside & (points_w[..., 2] > top - _ON_DECK_M)
        return on, self._numbers[index], top


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
    xy = cell_centres(terrain.extent, rows, columns)
    slope, height = (
        _standardise(scipy.ndimage.gaussian_filter(field, 1.0 / CELL_M))
        for field in (terrain.slope(xy), terrain.height(xy))
    )
    rng = stream(seed, "surfaces")
    sigma = (_PATCH_M / 4 * rows / (ymax - ymin), _PATCH_M / 4 * columns / (xmax - xmin))
    noise = (
        scipy.ndimage.gaussian_filter(rng.standard_normal((rows, columns)), sigma, mode="wrap") for _ in parts
    )
    fields = np.stack(
        [
            _standardise(field) + part.steep * slope + part.high * height
            for part, field in zip(parts, noise, strict=True)
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
