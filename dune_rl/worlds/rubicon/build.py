"""The rubicon world: a wooded hillside with rocks of every size, trees and undergrowth."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.seeding import stream
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.fractal_terrain import rough_field, slope_magnitude, smooth_step
from dune_rl.worlds.grass import grow_grass
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.props import merge_meshes
from dune_rl.worlds.rubicon.layout import place_props
from dune_rl.worlds.settings import GrassyConf, SeededConf
from dune_rl.worlds.surface_map import SurfaceShare, surface_map
from dune_rl.worlds.world import World

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

    Every `seed` gives a different hillside. The terrain's slopes result from
    hills and bumps together: with the defaults, their median is 15 degrees and
    their 90th percentile 26.
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
    props = place_props(
        terrain, conf.layout, conf.rocks_per_100m2, conf.trees_per_100m2, conf.undergrowth_per_100m2
    )
    reach = conf.region_size_m / 2
    solid = [(prop.vertices, prop.faces) for prop in props if prop.solid]
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
