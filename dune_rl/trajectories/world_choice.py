"""The world that a trajectory leads through: an option with its settings, or a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dune_rl.config.build import build_world
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.rendering.mesh_files.files import FORMATS as MESHES
from dune_rl.worlds.importing.heightmap.files import FORMATS as HEIGHT_MAPS
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.world import World

_SDF = (".sdf", ".world")


def choose_world(
    world: str | Mapping[str, Any], overrides: Sequence[str] = (), config_dirs: Sequence[str] = ()
) -> World:
    """The world of an option's name or of a file (SDF or model folder, mesh, map of heights).

    `overrides` are words such as `world.seed=3`. Raises `ConfigError` or `WorldError` for faults.
    """
    words = list(overrides)
    # Actors have no say in where one may walk.
    settings = {"actors": "none"}
    if isinstance(world, str) and _is_file(world):
        kind = _option_of(Path(world).expanduser())
        chosen: str | Mapping[str, Any] = {"name": kind, "path": world}
    else:
        chosen = world
    return build_world(compose_environment(chosen, words, settings, config_dirs=config_dirs).world)


def _is_file(world: str) -> bool:
    path = Path(world).expanduser()
    is_named = path.suffix.lower() in (*_SDF, *MESHES, *HEIGHT_MAPS) or "/" in world
    return is_named or (path.exists() and world not in WORLDS.names())


def _option_of(path: Path) -> str:
    kind = path.suffix.lower()
    if not path.exists():
        raise ConfigError(f"there is no file {path}: world=FILE must name one that exists")
    if path.is_dir() or kind in _SDF:
        return "sdf"
    if kind in MESHES:
        return "mesh"
    if kind in HEIGHT_MAPS:
        return "heightmap"
    known = ", ".join((*_SDF, *MESHES, *HEIGHT_MAPS))
    raise ConfigError(f"{path} is no world: {kind or 'no ending'} is none of {known}")
