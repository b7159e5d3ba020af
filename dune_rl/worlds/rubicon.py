"""The rubicon world: a wooded hillside with rocks of every size, trees and undergrowth."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds import trees
from dune_rl.worlds.fractal_terrain import rough_field, slope_magnitude, smooth_step
from dune_rl.worlds.grass import grow_grass
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.props import OccupiedDiscs, merge_meshes, unit_vector
from dune_rl.worlds.rocks import (
    SMALLEST_M,
    merge_rocks,
    merge_small_rocks,
    power_law_widths,
    relative_count_larger,
    rock,
)
from dune_rl.worlds.settings import GrassyConf, SeededConf
from dune_rl.worlds.surfaces import SurfaceShare, surface_map
from dune_rl.worlds.world import Prop, World

HALF_EXTENT_M = 22.0
# The shortest wavelength is two spacings, 0.8 m: less than three times the rover's wheelbase.
SPACING_M = 0.4
HILLS_M = (13.0, 60.0)
BUMPS_M = (0.8, 6.0)
HURST = 0.75

# Median slope of the hills in the central glade, relative to that elsewhere, on every seed.
_GLADE = 0.8
_GLADE_HALF_M, _GLADE_EDGE_M = 4.5, 7.0

FOREST_FLOOR = GroundColours(
    low=(0.30, 0.33, 0.17), high=(0.44, 0.41, 0.25), bare=(0.44, 0.36, 0.28), bare_from_rad=0.42
)

_SURFACES = (
    SurfaceShare("grass", 0.6, steep=-0.5),
    SurfaceShare("gravel", 0.2),
    SurfaceShare("rock", 0.2, steep=1.0),
)


class RubiconConf(GrassyConf, SeededConf):
    """Settings of `build_rubicon`.

    Every `seed` gives a different hillside. The terrain's slopes result from hills and bumps together: with
    the defaults, their median is 15 degrees and their 90th percentile 26.
    """

    name: Literal["rubicon"] = "rubicon"
    slope_rad: float = Field(default=0.23, ge=0.0, le=0.6, description="median slope of the hills")
    roughness_m: float = Field(
        default=0.07, ge=0.0, le=0.3, description="root mean square height of bumps under 6 m long"
    )
    rocks_per_100m2: float = Field(
        default=12.0, ge=0.0, le=40.0, description="rocks wider than 0.1 m; smaller ones come with them"
    )
    trees_per_100m2: float = Field(default=3.0, ge=0.0, le=12.0)
    undergrowth_per_100m2: float = Field(default=6.0, ge=0.0, le=40.0, description="bushes")
    region_size_m: float = Field(default=8.0, ge=3.0, le=40.0, description="side of the spawn region")


def build_rubicon(conf: RubiconConf) -> World:
    """The hillside of `conf.seed`, 44 by 44 m round the origin, with a gentler glade in the middle.

    Raises `WorldError` if the trees and rocks do not fit.
    """
    terrain = build_terrain(conf.seed, conf.slope_rad, conf.roughness_m)
    props = _place_props(terrain, conf)
    reach = conf.region_size_m / 2
    solid = [prop.mesh for prop in props if prop.solid]
    return World(
        "rubicon",
        terrain,
        props,
        region=(-reach, reach, -reach, reach),
        friction=conf.friction,
        ground=FOREST_FLOOR,
        texture_seed=conf.seed,
        # Merged, since hundreds of small meshes take a hundred times as long.
        grass=grow_grass(
            terrain, [merge_meshes(solid)] if solid else (), conf.grass_cover, conf.grass_height_m, conf.seed
        ),
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )


def build_terrain(seed: int, slope_rad: float, roughness_m: float) -> HeightField:
    """Hills of median slope `slope_rad`, with bumps of `roughness_m` [m] RMS on them."""
    rng = stream(seed, "rubicon terrain")
    axis = np.arange(-HALF_EXTENT_M, HALF_EXTENT_M + SPACING_M / 2, SPACING_M)
    shape = (len(axis), len(axis))
    hills = rough_field(rng, shape, SPACING_M, *HILLS_M, hurst=1.4)
    # High bumps cluster, which makes stony and smooth patches.
    patches = rough_field(rng, shape, SPACING_M, 7.0, 22.0, hurst=1.0)
    bumps = rough_field(rng, shape, SPACING_M, *BUMPS_M, hurst=HURST) * np.exp(0.3 * patches)
    bumps -= bumps.mean()
    steepness = slope_magnitude(hills, SPACING_M)
    beyond = np.maximum(np.abs(axis)[:, None], np.abs(axis)) - _GLADE_HALF_M
    glade = beyond < 0.0
    factor = _GLADE * np.median(steepness) / np.median(steepness[glade]) - 1.0
    hills -= hills[glade].mean()
    hills *= 1.0 + factor * (1.0 - smooth_step(beyond / _GLADE_EDGE_M))
    hills *= np.tan(slope_rad) / np.median(slope_magnitude(hills, SPACING_M))
    # Rounded to 1 mm, so that machines whose arithmetic differs in the last bits make the same terrain.
    z = np.round(hills + bumps * (roughness_m / bumps.std()), 3)
    return HeightField(z, SPACING_M, (-HALF_EXTENT_M, -HALF_EXTENT_M))


_EDGE_M = 1.5
_TRIES = 200
# Between props as wide as a wheel or wider: enough for a robot of up to 0.45 m radius.
_GAP_M = 0.9
_BLOCKS_FROM_M = 0.14
_STONES_PER_PATCH = 9
_PATCH_M = 1.0
_TREES_PER_LOG = 8


def _place_props(terrain: HeightField, conf: RubiconConf) -> list[Prop]:
    xmin, xmax, ymin, ymax = terrain.extent
    hundreds, seed = (xmax - xmin) * (ymax - ymin) / 100.0, conf.layout
    occupied = OccupiedDiscs()
    props = _place_trees(
        terrain, occupied, seed, round(conf.trees_per_100m2 * hundreds), conf.trees_per_100m2
    )
    count = round(conf.rocks_per_100m2 * hundreds * float(relative_count_larger(SMALLEST_M)))
    props += _place_rocks(terrain, occupied, seed, count, conf.rocks_per_100m2)
    rng = stream(seed, "rubicon undergrowth")
    bushes = _draw_bushes(terrain, rng, round(conf.undergrowth_per_100m2 * hundreds))
    return props + trees.undergrowth(terrain, bushes, rng)


def _draw_point(terrain: HeightField, rng: np.random.Generator) -> Array:
    xmin, xmax, ymin, ymax = terrain.extent
    low, high = np.array([xmin, ymin]) + _EDGE_M, np.array([xmax, ymax]) - _EDGE_M
    return rng.uniform(low, high)


def _find_free_point(
    terrain: HeightField, occupied: OccupiedDiscs, rng: np.random.Generator, radius: float, gap: float
) -> Array | None:
    for _ in range(_TRIES):
        xy = _draw_point(terrain, rng)
        if occupied.gap(xy, radius) >= gap:
            return xy
    return None


def _place_trees(
    terrain: HeightField, occupied: OccupiedDiscs, seed: int, count: int, per_100m2: float
) -> list[Prop]:
    rng = stream(seed, "rubicon trees")
    props: list[Prop] = []
    # The share of conifers differs from wood to wood.
    conifers = float(rng.choice([0.25, 0.5, 0.75]))
    for number in range(count):
        size = trees.sample_tree_size(rng)
        xy = _find_free_point(terrain, occupied, rng, 1.3 * size.radius_m, _GAP_M)
        if xy is None:
            raise WorldError(_no_room("trees_per_100m2", per_100m2))
        occupied.add(xy, 1.3 * size.radius_m)
        grow = trees.conifer if rng.uniform() < conifers else trees.broadleaf
        props += grow(terrain, f"tree {number + 1}", xy, size, rng)
    for number in range(count // _TREES_PER_LOG):
        length, radius = float(rng.uniform(1.6, 3.2)), float(rng.uniform(0.12, 0.2))
        xy = _find_free_point(terrain, occupied, rng, length / 2, _GAP_M)
        if xy is None:
            break
        yaw = float(rng.uniform(-np.pi, np.pi))
        for s in np.linspace(-length / 2, length / 2, 2 + int(length / radius)):
            occupied.add(xy + s * unit_vector(yaw), radius)
        props.append(trees.fallen_trunk(terrain, f"log {number + 1}", xy, yaw, length, radius))
    return props


def _place_rocks(
    terrain: HeightField, occupied: OccupiedDiscs, seed: int, count: int, per_100m2: float
) -> list[Prop]:
    rng = stream(seed, "rubicon rocks")
    sizes = power_law_widths(count)
    blocking = sizes >= _BLOCKS_FROM_M
    rocks = []
    for number, width in enumerate(sizes[blocking].tolist(), start=1):
        xy = _find_free_point(terrain, occupied, rng, width / 2, _GAP_M)
        if xy is None:
            raise WorldError(_no_room("rocks_per_100m2", per_100m2))
        occupied.add(xy, width / 2)
        rocks.append(rock(terrain, f"rock {number}", xy, width, rng))
    return merge_small_rocks(rocks) + _place_stones(terrain, occupied, rng, sizes[~blocking])


def _place_stones(
    terrain: HeightField, occupied: OccupiedDiscs, rng: np.random.Generator, sizes: Array
) -> list[Prop]:
    # Each patch of stones is one prop, since engines spend time on every body. Nothing spawns on them.
    props = []
    mixed = rng.permutation(sizes)
    patches = np.array_split(mixed, max(1, round(len(mixed) / _STONES_PER_PATCH)))
    for number, patch in enumerate(patches, start=1):
        if not len(patch):
            break
        xy = _find_free_point(terrain, occupied, rng, _PATCH_M / 2, 0.05)
        if xy is None:
            break
        occupied.add(xy, _PATCH_M / 2)
        turn = float(rng.uniform(-np.pi, np.pi))
        stones = []
        for index, width in enumerate(patch.tolist()):
            reach = (_PATCH_M - width) / 2 * np.sqrt((index + 0.5) / len(patch))
            stones.append(rock(terrain, "", xy + reach * unit_vector(turn + 2.4 * index), width, rng))
        props.append(merge_rocks(f"stones {number}", "stones", stones, drivable=True))
    return props


def _draw_bushes(terrain: HeightField, rng: np.random.Generator, count: int) -> Array:
    # Positions (count, 2) in groups of about five.
    places = np.empty((0, 2))
    while len(places) < count:
        group = _draw_point(terrain, rng) + rng.normal(0.0, 0.9, (int(rng.integers(3, 8)), 2))
        sides = np.reshape(terrain.extent, (2, 2))
        inside = np.abs(group - np.mean(sides, axis=1)) < (sides[:, 1] - sides[:, 0]) / 2 - 0.5
        places = np.concatenate([places, group[inside.all(axis=1)]])
    return places[:count]


def _no_room(setting: str, value: float) -> str:
    return f"The rubicon world has no room for world.{setting}={value:g} beside its other props: lower it."
