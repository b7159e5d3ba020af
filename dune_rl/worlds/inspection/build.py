"""An industrial site on hills: solar arrays, a pipeline, a bridge over a gully, culverts, walls and posts."""

from typing import Literal

from pydantic import Field

from dune_rl.worlds.grass import grow_grass
from dune_rl.worlds.inspection.layout import place_props
from dune_rl.worlds.inspection.terrain import YARD_CENTRE, YARD_HALF_M, build_terrain
from dune_rl.worlds.settings import GrassyConf, SeededConf
from dune_rl.worlds.surface_map import SurfaceShare, surface_map
from dune_rl.worlds.world import World

_SURFACES = (
    SurfaceShare("grass", 0.6),
    SurfaceShare("gravel", 0.25, steep=0.5),
    SurfaceShare("mud", 0.15, steep=-0.5, high=-1.0),
)


class InspectionConf(GrassyConf, SeededConf):
    """Settings of `build_inspection`.

    Every `seed` gives a different site with the same distribution of slopes,
    the same relief and a similar share of occupied ground.
    """

    name: Literal["inspection"] = "inspection"
    yard_obstacles: int = Field(
        default=4, ge=0, le=20, description="obstacles in and around the 8 by 8 m training square"
    )


def build_inspection(conf: InspectionConf) -> World:
    """The site of `conf.seed`: 60 by 60 m with a margin of 2 m; the training square is in the south-west."""
    terrain, gully = build_terrain(conf.seed)
    props = place_props(terrain, gully, conf.layout, conf.yard_obstacles)
    x, y = YARD_CENTRE
    region = (x - YARD_HALF_M, x + YARD_HALF_M, y - YARD_HALF_M, y + YARD_HALF_M)
    obstacles = [(prop.vertices, prop.faces) for prop in props]
    return World(
        "inspection",
        terrain,
        props,
        region=region,
        friction=conf.friction,
        texture_seed=conf.seed,
        grass=grow_grass(terrain, obstacles, conf.grass_cover, conf.grass_height_m, conf.seed),
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )
