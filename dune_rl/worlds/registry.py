"""Registry of worlds: built-in ones, those of installed packages, and those registered at run time."""

from dune_rl.core.errors import WorldError
from dune_rl.core.registry import Registry
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.validation import check_world
from dune_rl.worlds.world import World

WORLDS: Registry[World] = Registry(
    "world",
    "dune_rl.worlds.registry:WORLDS",
    own={
        "flat": "dune_rl.worlds.flat:build_flat",
        "inspection": "dune_rl.worlds.inspection.build:build_inspection",
        "construction": "dune_rl.worlds.construction.build:build_construction",
        "rubicon": "dune_rl.worlds.rubicon:build_rubicon",
        "island": "dune_rl.worlds.island:build_island",
        "obstacle_course": "dune_rl.worlds.obstacle_course:build_obstacle_course",
        "mixed": "dune_rl.worlds.mixed:build_mixed",
        "mesh": "dune_rl.worlds.importing.mesh_world:build_mesh",
        "heightmap": "dune_rl.worlds.importing.heightmap_world:build_heightmap",
        "sdf": "dune_rl.worlds.importing.sdf.build:build_sdf",
    },
    base=WorldSettings,
    product=World,
    form="a function that returns a World",
    error=WorldError,
    warning=WorldWarning,
)


def build_uncached(conf: WorldSettings) -> World:
    """The world of `conf`, without the cache. Raises `WorldError` if a user's world is invalid."""
    world = WORLDS.build(conf)
    if not WORLDS.part_of(conf).is_own:
        check_world(world)
    return world
