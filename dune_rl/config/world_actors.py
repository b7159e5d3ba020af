"""The default actors: those that a world's file brings along, or else walkers."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from dune_rl.config.agents import PERSON
from dune_rl.config.controller_settings import TRAJECTORY
from dune_rl.core.errors import WorldError

# The mark, in an option's file, of groups whose place the file's own actors take.
MARK = "unless_in_world"
GROUP = "actor"


def replace_default_actors(data: dict[str, Any], *, keep: bool = False) -> list[str]:
    """Replace marked groups of `data["actors"]` with the actors of the world's file, if it has any.

    Marks are removed; with `keep`, that is all. Returns the names of the groups that were replaced.
    """
    actors = data.get("actors")
    if not isinstance(actors, Mapping):
        return []
    marked = [name for name, group in actors.items() if isinstance(group, Mapping) and group.get(MARK)]
    plain = {
        name: {key: value for key, value in group.items() if key != MARK}
        if isinstance(group, Mapping)
        else group
        for name, group in actors.items()
    }
    count = _count_in_world(data.get("world")) if marked and not keep and not data.get("agents") else 0
    if count:
        plain = {name: group for name, group in plain.items() if name not in marked}
        plain[GROUP] = _merge(
            {"body": {"name": PERSON}, "count": count, "controller": TRAJECTORY}, plain.get(GROUP)
        )
    data["actors"] = plain
    return marked if count else []


def _merge(group: dict[str, Any], own: Any) -> dict[str, Any]:
    """A group with what its settings, `actors.actor.*`, say otherwise."""
    if not isinstance(own, Mapping):
        return group
    body = own.get("body")
    return group | dict(own) | ({"body": group["body"] | dict(body)} if isinstance(body, Mapping) else {})


def _count_in_world(world: Any) -> int:
    """Number of actors in a world's file; 0 for other worlds and for files that cannot be read."""
    if not isinstance(world, Mapping) or world.get("name") != "sdf" or not isinstance(world.get("path"), str):
        return 0
    # Only now: reading meshes needs libraries that other commands do without.
    from dune_rl.worlds.importing.sdf.build import count_actors

    with suppress(WorldError, OSError):
        return count_actors(world["path"])
    return 0
