"""The worlds there are: ours, those of installed packages, and those that a program registers."""

import json
from typing import Any

from dune_rl.errors import WorldError
from dune_rl.registry import Registry
from dune_rl.worlds.importing.untrusted_files import WorldWarning
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
        "rubicon": "dune_rl.worlds.rubicon.build:build_rubicon",
        "island": "dune_rl.worlds.island:build_island",
        "mesh": "dune_rl.worlds.importing.mesh.build:build_mesh",
        "heightmap": "dune_rl.worlds.importing.heightmap.build:build_heightmap",
        "sdf": "dune_rl.worlds.importing.sdf.build:build_sdf",
    },
    base=WorldSettings,
    product=World,
    form="a function that returns a World",
    error=WorldError,
    warning=WorldWarning,
)


def build(conf: WorldSettings) -> World:
    """The world of `conf`. A user's is checked: `WorldError` where it is unsound."""
    world = WORLDS.build(conf)
    if not WORLDS.part_of(conf).is_own:
        check_world(world)
    return world


def own_settings(values: dict[str, Any]) -> WorldSettings:
    """Settings of a world of ours, from their JSON; `ValueError` where they are not valid."""
    name = values.get("name")
    if name not in WORLDS.own:
        raise ValueError(f"no world of ours: {name!r}")
    settings: type[WorldSettings] | None = WORLDS.settings_class(name)
    assert settings is not None
    return settings.model_validate_json(json.dumps(values))
