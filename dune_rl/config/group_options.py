"""Options of groups: their names inside of settings, lists of them, and what scenarios and worlds change."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from dune_rl.config.agents import PERSON, PRESETS
from dune_rl.config.controllers import TRAJECTORY, plain_controller
from dune_rl.config.hydra_session import compose_words, to_plain
from dune_rl.config.overrides import SCENARIO, ParsedOverrides, option_names
from dune_rl.config.shorthands import change_group, is_robot_group
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.core.settings import merge_nested
from dune_rl.core.suggestions import advise, one_of
from dune_rl.sensors.conf import complete_entries
from dune_rl.worlds.registry import WORLDS

# The mark, in an option's file, of groups whose place the actors of a world's file take; and their name.
MARK, WORLD_ACTORS = "unless_in_world", "actor"


def _settings_of(group: str, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of an option with `changes`, but for the name, which need not be that of its file."""
    changed = {key: value for key, value in changes.items() if key != "name"}
    return merge_nested(to_plain(compose_words(f"{group}/{name}")[group]), changed)


def expand_robots(data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """Put settings in the place of the names in `robots`; the faults in the names."""
    robots = data.get("robots")
    if not isinstance(robots, list):
        return []
    names = option_names(loader, "robot")
    chosen: list[Any] = []
    faults: list[str] = []
    for robot in robots:
        changes = robot if isinstance(robot, Mapping) else {"name": robot}
        name = changes.get("name")
        if name in names:
            chosen.append(_settings_of("robot", name, changes))
        elif name is None:
            faults.append(f"robots: each is a name or has one: choose {one_of(names)} (got {robot!r})")
        else:
            faults.append(f"there is no robot {name!r}; choose {one_of(names)}")
    data["robots"] = chosen or (None if faults else [])
    return faults


def expand_groups(data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """Put settings in the place of names of options in `agents`; the faults in the names.

    A group's `body`, `sensors`, `task` and `metrics` are the name of an option, or a mapping with its `name`
    and the values that differ; a list of sensors is what is enabled. What has no known name is left out, so
    that the rest is checked.
    """
    faults: list[str] = []
    groups = data.get("agents")
    if isinstance(groups, Mapping):
        groups = {str(name): group for name, group in groups.items()}
        data["agents"] = {
            name: _expanded(group, f"agents.{name}", loader, faults) if isinstance(group, Mapping) else group
            for name, group in groups.items()
            if not name.isdigit()
        }
        for number in filter(str.isdigit, groups):
            # The last one has the name that was meant: robots come first.
            names = list(data["agents"])[-1:] or ["the name of a group"]
            faults.append(
                f"agents.{number}: agent groups have names, not numbers; write {names[0]} for {number}"
            )
    return faults


def _expanded(group: Mapping[str, Any], path: str, loader: ConfigLoader, faults: list[str]) -> dict[str, Any]:
    out = dict(group)
    if "controller" in group:
        out["controller"] = plain_controller(group["controller"])
    body = {"name": group["body"]} if isinstance(group.get("body"), str) else group.get("body")
    # Persons, and robots of users' packages, are known to the schema alone.
    if isinstance(body, Mapping) and body.get("name") in option_names(loader, "robot"):
        out["body"] = _settings_of("robot", str(body["name"]), body)
    for section, presets in PRESETS.items():
        value = group.get(section)
        if section == "sensors" and isinstance(value, list | tuple):
            value = out[section] = {"enabled": list(value)}
        changes = {"name": value} if isinstance(value, str) else value
        if not isinstance(changes, Mapping):
            continue
        name = changes.get("name")
        if not isinstance(name, str) or name in presets:
            continue
        known = option_names(loader, section)
        if name in known:
            out[section] = _settings_of(section, name, changes)
            if section == "sensors":
                # Faulty ones stay, for the check to report.
                with suppress(ValueError):
                    out[section] = complete_entries(out[section])
        else:
            remedy = advise(name, known)
            faults.append(f"{path}.{section}: there is no {section} {name!r}; {remedy}")
            out[section] = None
    return out


# -- scenarios ----------------------------------------------------------------------------------------


def drop_other_options(data: dict[str, Any], named: Iterable[str] = ()) -> None:
    """Leave out what a scenario changes of actors and of a world that others were chosen in place of.

    Such groups have no body, and such settings no field in the world's settings. Settings of the world that
    are `named` stay, so that the check says what lacks.
    """
    actors, world = data.get("actors"), data.get("world")
    if isinstance(actors, Mapping):
        data["actors"] = {name: group for name, group in actors.items() if _has_body(group)}
    name = world.get("name") if isinstance(world, Mapping) else None
    known = WORLDS.settings_class(name) if isinstance(name, str) and name in WORLDS.names() else None
    if isinstance(world, Mapping) and known is not None:
        fields = {*known.model_fields, *named}
        data["world"] = {key: value for key, value in world.items() if key in fields}


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `after` that `before` has otherwise or not at all."""
    found: dict[str, Any] = {}
    for key, value in after.items():
        earlier = before.get(key)
        if isinstance(value, Mapping) and isinstance(earlier, Mapping):
            if inner := difference(earlier, value):
                found[key] = inner
        elif key not in before or value != earlier:
            found[key] = value
    return found


def _has_body(group: Any) -> bool:
    if not isinstance(group, Mapping):
        return True
    body = group.get("body")
    return "name" in body if isinstance(body, Mapping) else body is not None


# -- lists of actors ----------------------------------------------------------------------------------


def describe_shared_groups(request: ParsedOverrides) -> list[str]:
    """Faults of lists of actors, as `actors=[orca,follow]`: groups that two of the options have.

    Composed, the second one would change the first one's group, or be the same group again.
    """
    faults = []
    for override in request.groups:
        options = override.value() if override.key_or_group == "actors" else None
        owners: dict[str, str] = {}
        listed = [str(option) for option in options] if isinstance(options, list) else []
        for option in dict.fromkeys(listed):
            if listed.count(option) > 1:
                faults.append(
                    f"actors: {option} is listed more than once; list it once, and for more of them set "
                    f"{' or '.join(f'actors.{name}.count' for name in _groups_of(option))}"
                )
            for name, group in _groups_of(option).items():
                if owners.setdefault(name, option) != option:
                    body, controller = group["body"], group.get("controller", "external")
                    body = body["name"] if isinstance(body, Mapping) else body
                    if isinstance(controller, Mapping):
                        controller = controller.get("name", controller)
                    faults.append(
                        f"actors: {owners[name]} and {option} are both of a group {name}; leave one of them "
                        f"out, and add its group by another name: '+actors.NAME={{body: {body}, "
                        f"count: {group.get('count', 1)}, controller: {controller}}}'"
                    )
    return faults


def _groups_of(option: str) -> dict[str, Mapping[str, Any]]:
    groups = to_plain(compose_words(f"actors/{option}")).get("actors") or {}
    return {name: group for name, group in groups.items() if isinstance(group, Mapping) and _has_body(group)}


# -- actors of a world's file -------------------------------------------------------------------------


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
        default = {"body": {"name": PERSON}, "count": count, "controller": TRAJECTORY}
        own = plain.get(WORLD_ACTORS)
        plain[WORLD_ACTORS] = merge_nested(default, own) if isinstance(own, Mapping) else default
    data["actors"] = plain
    return marked if count else []


def _count_in_world(world: Any) -> int:
    """Number of actors in a world's file; 0 for other worlds and for files that cannot be read."""
    if not isinstance(world, Mapping) or world.get("name") != "sdf" or not isinstance(world.get("path"), str):
        return 0
    # Only now: reading meshes needs libraries that other commands do without.
    from dune_rl.worlds.importing.sdf.build import count_actors

    with suppress(WorldError, OSError):
        return count_actors(world["path"])
    return 0


# -- changes of groups ---------------------------------------------------------------------------------


def change_groups(
    data: dict[str, Any], section: str, request: ParsedOverrides, changes: Mapping[str, Any] | None = None
) -> None:
    """Apply overrides of groups and of settings in them to a section of groups, then `changes` of Python."""
    replacing = (changes or {}).get(section, {})
    groups = (data.get(section) or {}) if isinstance(replacing, Mapping) else replacing
    if not isinstance(groups, Mapping):
        data[section] = groups
        return
    groups = dict(groups)
    keys = [(str(each.key_or_group).split("."), each) for each in request.group_changes]
    overrides = [(path, each) for (first, *path), each in keys if first == section]
    for path, each in overrides:
        try:
            change_group(groups, path, _value_of(each, data))
        except ConfigError as error:
            words = " ".join(str(each.input_line) for _, each in overrides)
            raise ConfigError(f"{error}; write the whole value, or one of the two: {words}") from None
    for name, value in replacing.items():
        change_group(groups, [str(name)], value)
    if groups:
        data[section] = groups


def _value_of(override: Override, data: Mapping[str, Any]) -> Any:
    value = override.value()
    if "${" not in str(override.input_line):
        return value
    return to_plain(OmegaConf.create({**data, "value_": value}))["value_"]


def change_saved_groups(
    saved: Mapping[str, Any], fresh: Mapping[str, Any], request: ParsedOverrides
) -> tuple[dict[str, Any], dict[str, str]]:
    """The agent groups of a run, changed by overrides; `fresh` are those that the overrides compose alone."""
    chosen = request.chosen()
    if "agents" in chosen:
        return dict(fresh), {}
    source = {True: saved, False: saved}
    if chosen & {"robot", "robots"}:
        source[True] = fresh
    if chosen & {"actors", SCENARIO}:
        source[False] = fresh
    robots, actors = (
        {name: group for name, group in source[of_robots].items() if is_robot_group(group) is of_robots}
        for of_robots in (True, False)
    )
    origins: dict[str, str] = {}
    if source[True] is saved:
        for override in request.values:
            section, *path = str(override.key_or_group).split(".")
            if section != "robot" or not path:
                continue
            if len(robots) > 1:
                raise ConfigError(
                    f"{override.input_line}: there are the robots {', '.join(robots)}; write agents.NAME.body"
                )
            (name,) = robots
            change_group(robots, [name, "body", *path], override.value())
            origins[f"agents.{name}.body"] = "robot"
    if source[False] is saved:
        for override in request.group_changes:
            section, *path = str(override.key_or_group).split(".")
            if section == "actors":
                change_group(actors, path, override.value())
    origins |= {f"agents.{name}": f"actors.{name}" for name in request.overridden_keys("actors")}
    return {**robots, **actors}, origins


def name_shorthands(message: str, origins: Mapping[str, str]) -> str:
    """An error's message, in which paths in `agents` are those of the shorthands that wrote there."""
    for path, origin in sorted(origins.items(), key=lambda item: -len(item[0])):
        message = re.sub(rf"(?<![\w.]){re.escape(path)}(?!\w)", origin, message)
    return message
