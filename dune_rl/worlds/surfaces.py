"""Ground materials: contact properties and sinkage of wheels, and their maps over terrain and decks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.geometry.rays import RayScene

SurfaceName = Literal["grass", "gravel", "mud", "sand", "rock", "concrete", "wood"]
SurfaceChoice = Literal["uniform", "natural", "grass", "gravel", "mud", "sand", "rock", "concrete", "wood"]


@dataclass(frozen=True)
class Soil:
    """Bekker's soil model: pressure at depth z is (k_c / b + k_phi) z^n under a strip of width b.

    `k_c` is in N/m^(n+1), `k_phi` in N/m^(n+2). M. G. Bekker, Introduction to Terrain-Vehicle Systems (1969);
    J. Y. Wong, Theory of Ground Vehicles, chapter 2.
    """

    k_c: float
    k_phi: float
    n: float

    def sinkage_m(self, load_n: float, diameter_m: float, width_m: float) -> float:
        """Sinkage [m] of a rigid wheel under `load_n` [N].

        z^((2n+1)/2) = 3 W / ((3 - n) (k_c + b k_phi) sqrt(D)), valid for n up to 1.3 and a sinkage small
        compared with the diameter D (Wong, chapter 2, after Bekker).
        """
        stiffness = self.k_c + width_m * self.k_phi
        ratio = 3.0 * load_n / ((3.0 - self.n) * stiffness * np.sqrt(diameter_m))
        return float(ratio ** (2.0 / (2.0 * self.n + 1.0)))

    def compaction_n(self, load_n: float, diameter_m: float, width_m: float) -> float:
        """Compaction resistance [N] of a wheel: (k_c + b k_phi) z^(n+1) / (n + 1) (Wong, chapter 2)."""
        depth = self.sinkage_m(load_n, diameter_m, width_m)
        return (self.k_c + width_m * self.k_phi) * depth ** (self.n + 1.0) / (self.n + 1.0)


@dataclass(frozen=True)
class Surface:
    """Contact properties of a rubber wheel on a ground material.

    `friction` and `restitution` are those of the pair of materials; `stiffness_npm` [N/m] and `damping_nspm`
    [N s/m] those of one wheel's contact; `rolling_resistance` is the resisting force over the load. `soil`
    determines sinkage, where that is enabled; `source` cites the figures.
    """

    name: str
    friction: float
    restitution: float
    stiffness_npm: float
    damping_nspm: float
    rolling_resistance: float
    soil: Soil | None = None
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("friction", "stiffness_npm"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} of surface {self.name!r} must be positive")
        if not 0.0 <= self.restitution <= 1.0:
            raise ValueError(f"restitution of surface {self.name!r} must be between 0 and 1")
        for name in ("damping_nspm", "rolling_resistance"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} of surface {self.name!r} must not be negative")


# Rolling resistance of the tyre itself, which compaction adds to on soils with sinkage.
TYRE_RESISTANCE = 0.015

# Stiffness of soils: a rigid disc of the contact patch's radius a = 20 mm (chosen) on an elastic half-space,
# 2 E a / (1 - nu^2) with nu = 0.3 (Johnson, Contact Mechanics, 1985, section 3.4). Damping: stiffness times
# 20 ms, the time constant with which the engine resolves penetration; less damping lets the contact ring,
# which hides the restitution (mud, with restitution 0, has 40 ms). The millimetre by which tyres deform is
# neglected.
_WONG = "Wong, Theory of Ground Vehicles, table of road adhesion after Taborek (1957)"
_LLL = "Land Locomotion Laboratory, in Wong"
_TOOLBOX = "The Engineering ToolBox, Rolling Resistance"
_HOEK = "Hoek, Practical Rock Engineering, table of rockfall"
_OBRZUD = "Obrzud and Truty, The Hardening Soil Model (2012), after Kezdi and Prat"

_SOURCES = {
    "grass": (
        "friction: chosen between wet grass, 0.2 (Noon, Engineering Analysis of Vehicular "
        f"Accidents, 1994), and a dry earth road, 0.65 to 0.68 ({_WONG}); restitution: soft soil "
        f"with vegetation ({_HOEK}); stiffness: E = 5 MPa, soft silt ({_OBRZUD}); rolling: medium "
        f"hard soil, 0.04 to 0.08 ({_TOOLBOX})"
    ),
    "gravel": (
        f"friction: gravel, 0.6 at its peak ({_WONG}); restitution: talus ({_HOEK}); stiffness: E "
        f"= 30 MPa, loose gravel ({_OBRZUD}); rolling: loose gravel, 0.06 (Moyer, in Marks' "
        "Standard Handbook for Mechanical Engineers)"
    ),
    "mud": (
        f"friction: wet earth road, 0.4 to 0.5 sliding ({_WONG}); restitution: chosen, it flows; "
        f"stiffness: E = 1 MPa, very soft clay ({_OBRZUD}); rolling: field, 0.1 to 0.35 (Wong, "
        f"Theory of Ground Vehicles); soil: sandy loam with 22 % of water ({_LLL})"
    ),
    "sand": (
        f"friction: tan 28 degrees, the angle of shearing of dry sand ({_LLL}), its small cohesion "
        "left out; restitution: chosen, its grains take up the blow; stiffness: E = 10 MPa, loose "
        f"uniform sand ({_OBRZUD}); rolling: loose sand, 0.2 to 0.4 ({_TOOLBOX}), 0.1 to 0.2 "
        f"(Carvill, Mechanical Engineer's Data Handbook, 1993); soil: dry sand ({_LLL})"
    ),
    "rock": (
        f"friction: chosen, as locked wheels on dry asphalt ({_WONG}); restitution: clean hard "
        f"bedrock ({_HOEK}); stiffness: chosen, since tens of GPa are rigid to an engine; rolling: "
        f"large worn cobbles, 0.03 ({_TOOLBOX})"
    ),
    "concrete": (
        f"friction: dry concrete, 0.8 to 0.9 at its peak and 0.75 sliding ({_WONG}); restitution: "
        f"asphalt ({_HOEK}); stiffness: chosen, since tens of GPa are rigid to an engine; rolling: "
        f"0.010 to 0.015 ({_TOOLBOX})"
    ),
    "wood": (
        "chosen: planks neither clean and dry nor wet, between concrete and gravel in grip and in "
        "rolling, and nearly rigid, since no table for tyres on decks was found"
    ),
}
_ROWS: tuple[tuple[SurfaceName, tuple[float, float, float, float, float], Soil | None], ...] = (
    # Friction, restitution, stiffness [N/m], damping [N s/m] and rolling resistance.
    ("grass", (0.5, 0.30, 2.2e5, 4.4e3, 0.07), None),
    ("gravel", (0.6, 0.32, 1.3e6, 2.6e4, 0.06), None),
    ("mud", (0.45, 0.0, 4.4e4, 1.8e3, 0.15), Soil(k_c=2.56e3, k_phi=43.12e3, n=0.2)),
    ("sand", (0.53, 0.05, 4.4e5, 8.8e3, 0.2), Soil(k_c=0.99e3, k_phi=1528.43e3, n=1.1)),
    ("rock", (0.75, 0.53, 1e7, 2e5, 0.03), None),
    ("concrete", (0.8, 0.40, 1e7, 2e5, 0.015), None),
    ("wood", (0.6, 0.40, 5e6, 1e5, 0.02), None),
)
SURFACES = tuple(Surface(name, *numbers, soil, _SOURCES[name]) for name, numbers, soil in _ROWS)
SURFACE_NAMES: tuple[SurfaceName, ...] = get_args(SurfaceName)


@dataclass(frozen=True)
class WheelLoad:
    """Load of one wheel on the ground [N], and the wheel's diameter and width [m]."""

    load_n: float
    diameter_m: float
    width_m: float


def contact_table(
    surfaces: tuple[Surface, ...], wheel: WheelLoad, *, sinkage: bool, gravity_mps2: float = 9.81
) -> tuple[Array, Array]:
    """Contact and rolling parameters of a wheel on each of S surfaces.

    The first array, (S, 4), is friction, restitution, stiffness [N/m] and damping [N s/m] of a contact; the
    second, (S,), rolling resistance over load. With `sinkage`, the contact on a soil has the surface's
    stiffness in series with W / z, for the load W and Bekker's sinkage z, and is critically damped, since
    soil does not spring back. The rolling resistance is then that of the tyre plus that of compaction,
    instead of the surface's figure, which includes both.
    """
    contacts = np.array([[s.friction, s.restitution, s.stiffness_npm, s.damping_nspm] for s in surfaces])
    rolling = np.array([s.rolling_resistance for s in surfaces])
    if sinkage:
        size = wheel.load_n, wheel.diameter_m, wheel.width_m
        for row, soil in enumerate(surface.soil for surface in surfaces):
            if soil is None:
                continue
            stiffness = 1.0 / (1.0 / contacts[row, 2] + soil.sinkage_m(*size) / wheel.load_n)
            contacts[row, 2] = stiffness
            contacts[row, 3] = 2.0 * np.sqrt(stiffness * wheel.load_n / gravity_mps2)
            rolling[row] = TYRE_RESISTANCE + soil.compaction_n(*size) / wheel.load_n
    return contacts, rolling


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
