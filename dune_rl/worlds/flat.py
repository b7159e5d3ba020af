"""The flat world: a level plane without obstacles."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.grass import grow_grass
from dune_rl.worlds.ground_texture import GRAVEL
from dune_rl.worlds.settings import GrassyConf
from dune_rl.worlds.surfaces import SURFACE_NAMES, SurfaceShare, surface_map
from dune_rl.worlds.world import World

# Contact solvers lose precision on triangles much longer than the robot.
_SPACING_M = 5.0

_SURFACES = tuple(SurfaceShare(name, 1.0 / len(SURFACE_NAMES)) for name in SURFACE_NAMES)


class FlatConf(GrassyConf):
    """Settings of `build_flat`."""

    # The plane is built faster than it is read.
    disk_cached = "appearance"
    name: Literal["flat"] = "flat"
    size_m: float = Field(default=100.0, ge=20.0, le=1000.0, description="length of the plane's side")
    region_size_m: float = Field(default=8.0, gt=0.0, le=1000.0, description="side of the spawn region")


def build_flat(conf: FlatConf) -> World:
    """A level square at z = 0, centred on the origin."""
    cells = int(np.ceil(conf.size_m / _SPACING_M))
    half, reach = conf.size_m / 2, conf.region_size_m / 2
    terrain = HeightField(np.zeros((cells + 1, cells + 1)), conf.size_m / cells, (-half, -half))
    return World(
        "flat",
        terrain,
        region=(-reach, reach, -reach, reach),
        friction=conf.friction,
        ground=GRAVEL,
        grass=grow_grass(terrain, (), conf.grass_cover, conf.grass_height_m, seed=0),
        surfaces=surface_map(conf.surfaces, terrain, 0, _SURFACES, sinkage=conf.sinkage),
    )
