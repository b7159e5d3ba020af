"""The older form of `actors`: a list of walkers, each with settings of body, path and controller."""

from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.bodies.person import PersonConf
from dune_rl.config.agents import PERSON, free_name
from dune_rl.config.controller_settings import EXTERNAL, PATH

_DEFAULTS: dict[str, Any] = {
    "kind": "walker",
    "controller": "scripted",
    **PersonConf().model_dump(mode="json", exclude={"name"}),
    **PathConf().model_dump(mode="json"),
}


def groups_of_list(actors: Sequence[Any]) -> dict[str, Any]:
    """Agent groups, as plain data, of a list of walkers: equal ones are one group.

    Those that are `external` are called `walker` first, then the others; a
    further group is `walker_b`, and so on. Settings that a walker does not have
    stay where they are, so that the check names them.
    """
    counts: dict[str, Any] = {}
    entries: dict[str, dict[str, Any]] = {}
    for actor in actors:
        given = dict(actor) if isinstance(actor, Mapping) else {"body": actor}
        entry = {key: given.get(key, value) for key, value in (_DEFAULTS | given).items() if key != "count"}
        key = repr(sorted(entry.items()))
        count = given.get("count", 1)
        counts[key] = counts.get(key, 0) + count if isinstance(count, int) else count
        entries[key] = entry
    named: dict[str, str] = {}
    for key in sorted(entries, key=lambda key: entries[key]["controller"] != EXTERNAL):
        named[key] = free_name("walker", named.values())
    return {named[key]: _group(entry, counts[key]) for key, entry in entries.items()}


def _group(entry: Mapping[str, Any], count: Any) -> dict[str, Any]:
    body = {"name": PERSON if entry["kind"] == "walker" else entry["kind"]}
    path: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    for key, value in entry.items():
        if key in PersonConf.model_fields:
            body[key] = value
        elif key in PathConf.model_fields:
            path[key] = value
        elif key not in ("kind", "controller"):
            rest[key] = value
    controller = PATH if entry["controller"] == "scripted" else entry["controller"]
    return {"count": count, "controller": controller, "body": body, "path": path, **rest}
