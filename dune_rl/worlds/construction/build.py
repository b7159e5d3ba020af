"""The construction world: rooms of plastered and stud walls with building materials in them."""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.construction.layout import place_props
from dune_rl.worlds.construction.walls import build_storey
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.settings import SeededConf, SurfacedConf
from dune_rl.worlds.surface_map import SurfaceShare, surface_map
from dune_rl.worlds.world import World

LENGTH_M, WIDTH_M = 44.0, 25.0
SPACING_M = 0.5
# Distance from the floor's edge to the building.
_MARGIN_M = 2.0
_MOUND_RADII_M = (2.0, 2.85)

# The floor is level, so only the mounds' slopes show bare earth.
_CONCRETE = GroundColours(
    low=(0.52, 0.51, 0.49), high=(0.60, 0.59, 0.56), bare=(0.47, 0.40, 0.32), bare_from_rad=0.16, contrast=0.5
)

_SURFACES = (
    SurfaceShare("concrete", 0.7),
    SurfaceShare("sand", 0.15, high=1.0),
    SurfaceShare("gravel", 0.15),
)


class ConstructionConf(SurfacedConf, SeededConf):
    """Settings of `build_construction`."""

    name: Literal["construction"] = "construction"
    room_size_m: float = Field(
        default=6.0, ge=4.0, le=20.0, description="rooms longer than 1.6 times this are divided"
    )
    door_width_m: float = Field(default=1.3, ge=1.0, le=2.0)
    stud_share: float = Field(default=0.35, ge=0.0, le=1.0, description="share of walls that are bare frames")
    props_per_100m2: float = Field(
        default=2.8, ge=0.0, le=8.0, description="bricks, beams, sawhorses, crates and containers"
    )
    mounds_per_100m2: float = Field(default=1.0, ge=0.0, le=4.0)
    mound_height_m: float = Field(default=0.15, ge=0.0, le=0.6)
    region_size_m: float = Field(default=8.0, ge=3.0, le=20.0, description="side of the spawn region")

    @model_validator(mode="after")
    def _doors_fit(self) -> Self:
        if self.room_size_m < 3.4 * self.door_width_m:
            raise ValueError(
                f"room_size_m must be at least 3.4 times door_width_m={self.door_width_m:g} "
                f"(got {self.room_size_m:g})"
            )
        return self


def build_construction(conf: ConstructionConf) -> World:
    """The site of `conf.seed`: a floor of 44 by 25 m round the origin, most of it divided into rooms.

    Raises `WorldError` if the props do not fit.
    """
    terrain = build_floor(conf.seed, conf.mounds_per_100m2, conf.mound_height_m)
    plan = (
        -LENGTH_M / 2 + _MARGIN_M,
        LENGTH_M / 2 - _MARGIN_M,
        -WIDTH_M / 2 + _MARGIN_M,
        WIDTH_M / 2 - _MARGIN_M,
    )
    storey = build_storey(terrain, plan, conf.layout, conf.room_size_m, conf.door_width_m, conf.stud_share)
    props = place_props(terrain, storey, conf.layout, conf.props_per_100m2)
    reach = conf.region_size_m / 2
    return World(
        "construction",
        terrain,
        [*storey.props, *props],
        region=(-reach, reach, -reach, reach),
        friction=conf.friction,
        ground=_CONCRETE,
        texture_seed=conf.seed,
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )


def build_floor(seed: int, mounds_per_100m2: float, mound_height_m: float) -> HeightField:
    """A level floor at z = 0 with round mounds 4 to 5.7 m wide, spread out over it."""
    rng = stream(seed, "construction mounds")
    x = np.arange(-LENGTH_M / 2, LENGTH_M / 2 + SPACING_M / 2, SPACING_M)
    y = np.arange(-WIDTH_M / 2, WIDTH_M / 2 + SPACING_M / 2, SPACING_M)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    z = np.zeros(xy.shape[:2])
    count = round(mounds_per_100m2 * LENGTH_M * WIDTH_M / 100.0)
    half = np.array([LENGTH_M / 2, WIDTH_M / 2]) - _MOUND_RADII_M[1]
    centres = _spread_points(rng, half, count)
    radii = rng.uniform(*_MOUND_RADII_M, count)
    for centre, radius in zip(centres, radii, strict=True):
        away = np.minimum(np.hypot(*np.moveaxis(xy - centre, -1, 0)) / radius, 1.0)
        z = np.maximum(z, mound_height_m * (1.0 + np.cos(np.pi * away)) / 2)
    # Rounded to 1 mm, so that machines whose arithmetic differs in the last bits make the same terrain.
    return HeightField(np.round(z, 3), SPACING_M, (x[0], y[0]))


def _spread_points(rng: np.random.Generator, half: Array, count: int) -> Array:
    # Best-candidate sampling: of 12 random points, the one farthest from those before it.
    centres = np.empty((0, 2))
    for _ in range(count):
        draws = rng.uniform(-half, half, (12, 2))
        if len(centres):
            nearest = np.linalg.norm(draws[:, None] - centres, axis=-1).min(axis=1)
            draws = draws[[nearest.argmax()]]
        centres = np.concatenate([centres, draws[:1]])
    return centres
