"""The families of worlds: the settings of every one, and what builds it."""

from typing import Annotated

from pydantic import Field, TypeAdapter

from dune_rl.worlds.construction import ConstructionConf, build_construction
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.importing.heightmap import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.imported_mesh import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf import SdfConf, build_sdf
from dune_rl.worlds.inspection import InspectionConf, build_inspection
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.rubicon import RubiconConf, build_rubicon
from dune_rl.worlds.world import World

WorldConf = Annotated[
    FlatConf
    | InspectionConf
    | ConstructionConf
    | RubiconConf
    | IslandConf
    | MeshConf
    | HeightmapConf
    | SdfConf,
    Field(discriminator="name"),
]

# Of the others' code nothing is known that would tell when a kept world is out of date; and a plane is built
# faster than it is read.
KEPT = (InspectionConf, ConstructionConf, RubiconConf, IslandConf, MeshConf, HeightmapConf, SdfConf)
# Those whose looks are worth keeping.
SHELVED = (*KEPT, FlatConf)

_SETTINGS: TypeAdapter[WorldConf] = TypeAdapter(WorldConf)


def from_json(text: bytes) -> WorldConf:
    """The settings of a world that were written as JSON; `ValueError` where they are not valid."""
    return _SETTINGS.validate_json(text)


def build(conf: WorldConf) -> World:
    """A world of those settings, generated or imported anew."""
    match conf:
        case FlatConf():
            return build_flat(conf)
        case InspectionConf():
            return build_inspection(conf)
        case ConstructionConf():
            return build_construction(conf)
        case RubiconConf():
            return build_rubicon(conf)
        case IslandConf():
            return build_island(conf)
        case MeshConf():
            return build_mesh(conf)
        case HeightmapConf():
            return build_heightmap(conf)
        case SdfConf():
            return build_sdf(conf)
