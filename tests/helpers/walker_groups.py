"""Agent groups of walkers, from a list of what differs in each."""

from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.bodies.person import PersonConf
from dune_rl.config.agents import free_name


def walker_groups(walkers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Groups of equal walkers: `walker`, `walker_b`, ..., external ones first."""
    counts: dict[str, int] = {}
    entries: dict[str, Mapping[str, Any]] = {}
    for walker in walkers:
        key = repr(
            sorted(({"controller": "scripted"} | dict(walker) | {"count": 1, "kind": "walker"}).items())
        )
        counts[key] = counts.get(key, 0) + walker.get("count", 1)
        entries[key] = walker
    names: dict[str, str] = {}
    for key in sorted(entries, key=lambda key: entries[key].get("controller") != "external"):
        names[key] = free_name("walker", names.values())
    groups = {}
    for key, walker in entries.items():
        groups[names[key]] = {
            "count": counts[key],
            "controller": walker.get("controller", "path").replace("scripted", "path"),
            "body": {"name": "person", **{k: v for k, v in walker.items() if k in PersonConf.model_fields}},
            "path": {k: v for k, v in walker.items() if k in PathConf.model_fields},
        }
    return groups
