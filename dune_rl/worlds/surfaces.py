"""Ground materials: friction, restitution, compliance, rolling resistance, and sinkage of soft soil."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dune_rl.geometry.arrays import Array

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
