"""The island world: very bumpy ground with a few boxes, surrounded by water."""

from dataclasses import replace
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.worlds.fractal_terrain import rough_field, smooth_step
from dune_rl.worlds.grass import Grass, grow_grass
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.props import OccupiedRectangles, axes_of, unit_vector, upright_box
from dune_rl.worlds.settings import GrassyConf, SeededConf
from dune_rl.worlds.surfaces import SurfaceShare, surface_map
from dune_rl.worlds.world import Colour, Prop, World

# Four points per metre, the shortest bump length; a wheel's radius is about half a spacing.
SPACING_M = 0.25
SHALLOWS_M = 4.0
LAND_M = 0.9
_SEABED_M = -0.7
_SHORE_M = 4.5
_MEDIUM_M = 0.15
# Largest deviation of the coast from a circle, relative to its radius.
_COAST = 0.14

_GAP_M = 1.1
_TRIES = 400
_SUNK_M = 0.5
_SEA_REACH_M = 8.0
_GRASS_FROM_M = 0.2

_SAND = GroundColours(
    low=(0.74, 0.66, 0.49), high=(0.52, 0.53, 0.30), bare=(0.66, 0.57, 0.42), bare_from_rad=0.42
)
_WATER: Colour = (0.16, 0.42, 0.52)
_PAINTS: tuple[Colour, ...] = (
    (0.78, 0.76, 0.70),
    (0.72, 0.35, 0.25),
    (0.30, 0.45, 0.60),
    (0.82, 0.68, 0.30),
    (0.45, 0.46, 0.48),
)

# Shares of the whole terrain, half of which is under water.
_SURFACES = (
    SurfaceShare("sand", 0.72, high=-0.5),
    SurfaceShare("rock", 0.13, steep=0.7),
    SurfaceShare("mud", 0.15, steep=-0.5, high=0.3),
)


class IslandConf(GrassyConf, SeededConf):
    """Settings of `build_island`.

    Slopes are proportional to `roughness_m` / `bump_length_m`: with the
    defaults, their median inland is 14 degrees and their 90th percentile 24.
    """

    name: Literal["island"] = "island"
    radius_m: float = Field(default=9.0, ge=7.0, le=20.0, description="mean distance from middle to shore")
    roughness_m: float = Field(
        default=0.085, ge=0.0, le=0.3, description="root mean square height of the bumps"
    )
    bump_length_m: float = Field(default=2.0, ge=1.0, le=6.0, description="mean length of the bumps")
    boxes_per_100m2: float = Field(default=2.5, ge=0.0, le=8.0, description="boxes on land")
    region_size_m: float = Field(default=8.0, ge=3.0, le=24.0, description="side of the spawn region")

    @model_validator(mode="after")
    def _region_on_land(self) -> Self:
        largest = np.sqrt(2.0) * dry_radius(self.radius_m)
        if self.region_size_m > largest:
            raise ValueError(
                f"region_size_m must be at most {largest:.1f} for radius_m={self.radius_m:g}, "
                f"or its corners are in the sea (got {self.region_size_m:g})"
            )
        return self


def dry_radius(radius_m: float) -> float:
    """Radius [m] of the disc round the middle that is above the beach on every seed."""
    return radius_m * (1.0 - _COAST) - 0.4 * _SHORE_M


def build_island(conf: IslandConf) -> World:
    """The island of `conf.seed` round the origin; sea level is z = 0, and the sea is 0.7 m deep.

    Raises `WorldError` if the boxes do not fit.
    """
    coast = _coast(conf.seed, conf.radius_m)
    terrain = _terrain(conf, coast)
    boxes = _boxes(conf, terrain)
    sea = _sea(terrain, coast)
    reach = conf.region_size_m / 2
    return World(
        "island",
        terrain,
        [*boxes, sea],
        region=(-reach, reach, -reach, reach),
        friction=conf.friction,
        ground=_SAND,
        texture_seed=conf.seed,
        grass=_grass(conf, terrain, boxes),
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )


def _coast(seed: int, radius_m: float) -> Array:
    # Amplitudes and phases (4, 2) of the waves in the coast's distance from the middle.
    rng = stream(seed, "island coast")
    waves = rng.uniform(0.3, 1.0, 4) / np.array([1.0, 1.3, 1.8, 2.4])
    waves *= _COAST / waves.sum()
    return np.column_stack([radius_m * waves, rng.uniform(0.0, 2 * np.pi, 4)])


def _coast_distance(coast: Array, radius_m: float, angle: Array) -> Array:
    waves = coast[:, 0] * np.cos(angle[..., None] * np.arange(2, 6) + coast[:, 1])
    return radius_m + waves.sum(axis=-1)


def _terrain(conf: IslandConf, coast: Array) -> HeightField:
    rng = stream(conf.seed, "island terrain")
    half = SPACING_M * np.ceil((1.1 * conf.radius_m + SHALLOWS_M) / SPACING_M)
    axis = np.arange(-half, half + SPACING_M / 2, SPACING_M)
    x, y = np.meshgrid(axis, axis)
    inland = _coast_distance(coast, conf.radius_m, np.arctan2(y, x)) - np.hypot(x, y)
    # The step's argument is 0.458 at sea level, z = 0.
    share = smooth_step(inland / _SHORE_M + 0.458)
    base = _SEABED_M + (LAND_M - _SEABED_M) * share
    shape = x.shape
    medium = rough_field(rng, shape, SPACING_M, 5.0, 12.0, hurst=1.0)
    # Bumps of similar size, unlike those of a hillside, which have every size.
    length = conf.bump_length_m
    bumps = rough_field(rng, shape, SPACING_M, 0.6 * length, 1.8 * length, hurst=0.0)
    z = base + share * _MEDIUM_M * medium + (0.4 + 0.6 * share) * conf.roughness_m * bumps
    # Rounded to 1 mm, so that machines whose arithmetic differs in the last bits make the same terrain.
    return HeightField(np.round(z, 3), SPACING_M, (-half, -half))


def _boxes(conf: IslandConf, terrain: HeightField) -> list[Prop]:
    rng = stream(conf.layout, "island boxes")
    occupied = OccupiedRectangles()
    reach = dry_radius(conf.radius_m)
    count = round(conf.boxes_per_100m2 * np.pi * conf.radius_m**2 / 100.0)
    boxes = []
    for number in range(count):
        length, width = float(rng.uniform(0.6, 1.8)), float(rng.uniform(0.4, 1.0))
        height = float(rng.uniform(0.5, 1.2))
        for _ in range(_TRIES):
            xy = reach * np.sqrt(rng.uniform()) * unit_vector(float(rng.uniform(-np.pi, np.pi)))
            yaw = float(rng.uniform(-np.pi, np.pi))
            if occupied.gap(xy, yaw, length, width) >= _GAP_M:
                break
        else:
            raise WorldError(
                f"The island has no room for world.boxes_per_100m2={conf.boxes_per_100m2:g}: "
                f"box {number + 1} of {count} fits nowhere. Lower it, or raise world.radius_m."
            )
        occupied.add(xy, yaw, length, width)
        corners = xy + np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [0, 0]]) / 2 * [length, width] @ axes_of(
            yaw
        )
        ground = terrain.height(corners)
        mesh = upright_box(xy, yaw, ground.min() - _SUNK_M, ground[-1] + height, length, width)
        colour = _PAINTS[int(rng.integers(len(_PAINTS)))]
        boxes.append(Prop(f"box {number + 1}", "box", *mesh, colour=colour))
    return boxes


def _grass(conf: IslandConf, terrain: HeightField, boxes: list[Prop]) -> Grass | None:
    boxes_alone = [prop.mesh for prop in boxes]
    grass = grow_grass(terrain, boxes_alone, conf.grass_cover, conf.grass_height_m, conf.seed)
    if grass is None:
        return None
    dry = terrain.height(cell_centres(terrain.extent, *grass.density.shape)) > _GRASS_FROM_M
    return replace(grass, density=np.where(dry, grass.density, np.float32(0.0)))


def _sea(terrain: HeightField, coast: Array) -> Prop:
    # A ring from under the beach to beyond the terrain's edge, which is only visible.
    angle = np.linspace(0.0, 2 * np.pi, 96, endpoint=False)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    half = terrain.extent[1]
    mean = (half - SHALLOWS_M) / 1.1
    inner = (_coast_distance(coast, mean, angle) - 0.45 * _SHORE_M)[:, None] * around
    outer = (half + _SEA_REACH_M) * np.sqrt(2.0) * around
    vertices = np.column_stack([np.vstack([inner, outer]), np.zeros(192)])
    here = np.arange(96)
    there = np.roll(here, -1)
    faces = np.concatenate(
        [np.stack([here, here + 96, there + 96], axis=1), np.stack([here, there + 96, there], axis=1)]
    )
    return Prop("sea", "water", vertices, faces.astype(np.int32), solid=False, colour=_WATER)
