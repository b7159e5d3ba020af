"""The one form of agent groups, `agents`, and the shorthands that write into it."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import ValidationError

from dune_rl.bodies.registry import BODIES
from dune_rl.config.agents import (
    PRESETS,
    SECTIONS,
    free_name,
    is_complete,
    is_on_path,
    parse_members,
    parse_section,
    preset_settings,
    presets_of,
)
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.settings import merge_nested
from dune_rl.robots.registry import ROBOTS
from dune_rl.sensors.conf import default_sensors, parse_sensors, read_entries

SHORTHANDS = ("robot", "robots", "actors")
_DEFAULT_ROBOT = {"name": "rover_zero"}
# Sections of a group that may be the name of an option, and keys of controllers that have no name.
_NAMED = ("body", "controller", *SECTIONS)
_NAMELESS = {"checkpoint", "group", "trajectory"}


def write_agents(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with all agent groups in `agents`, and no shorthand; `ValueError` for faulty shorthands."""
    return complete_sections(join_groups(data)[0])


def join_groups(data: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """`data` with the groups of the shorthands in `agents`, unless it has `agents`.

    Equal robots are one group. Rover Zero's is called `rover`, another has its robot's name; a further one of
    a name gets `_b`, `_c` and so on. Also returns the path of the shorthand for each path in `agents`.
    """
    out = {name: value for name, value in data.items() if name not in SHORTHANDS}
    if out.get("agents") is not None:
        return out, {}
    actors, robots = data.get("actors") or {}, data.get("robots")
    if not isinstance(actors, Mapping):
        raise ValueError(f"actors must be a section with settings of its own (got {actors!r})")
    if robots is not None and (isinstance(robots, str) or not isinstance(robots, Sequence) or not robots):
        equal = f"; for equal ones write agents.rover.count={robots}" if isinstance(robots, int) else ""
        raise ValueError(
            f"robots must be a list of robots, such as [rover_zero,leo_rover] (got {robots!r}){equal}"
        )
    robot = data.get("robot")
    if isinstance(robot, Mapping) and "count" in robot:
        raise ValueError(
            f"robot is one robot, without a count; for equal ones write agents.{_label(robot)}.count="
            f"{robot['count']}, for others a list such as robots=[rover_zero,leo_rover]"
        )
    sources = {"robot": data.get("robot") or _DEFAULT_ROBOT}
    if robots is not None:
        sources = {f"robots.{number}": robot for number, robot in enumerate(robots)}
    groups: dict[str, Any] = {}
    origins = {f"agents.{name}": f"actors.{name}" for name in actors}
    bodies: list[tuple[Any, str]] = []
    for source, robot in sources.items():
        body: Any = robot
        # A faulty robot is reported where all is validated.
        with suppress(ValueError, DuneError):
            body = ROBOTS.parse_settings(robot)
        name = next((name for known, name in bodies if known == body), None)
        if name is None:
            name = free_name(_label(robot), {*actors, *groups})
            groups[name] = {"body": robot, "count": 0, "controller": "external"}
            origins[f"agents.{name}.body"] = source
            bodies.append((body, name))
        groups[name]["count"] += 1
    out["agents"] = {**groups, **actors}
    return out, origins


def _label(robot: Any) -> str:
    """What the group of a robot is called, given its settings."""
    label = robot.get("name") if isinstance(robot, Mapping) else getattr(robot, "name", None)
    return "rover" if label == "rover_zero" else re.sub(r"\W", "_", str(label))


def complete_sections(data: dict[str, Any]) -> dict[str, Any]:
    """`data`, in which sections of groups that state some settings have the others of their preset, too."""
    if "sensors" in data:
        data["sensors"] = _sensor_entries(data["sensors"])
    groups = data.get("agents")
    if isinstance(groups, Mapping):
        data["agents"] = {name: _completed(group, data) for name, group in groups.items()}
    return data


def _completed(group: Any, data: Mapping[str, Any]) -> Any:
    """A group with whole sections; faulty parts stay as they are, for the check to name them."""
    if not isinstance(group, Mapping):
        return group
    out = dict(group)
    for section in SECTIONS:
        changes = group.get(section)
        if not isinstance(changes, Mapping) or is_complete(section, changes):
            continue
        preset = changes.get("name")
        if preset not in PRESETS[section]:
            members = parse_members(group)
            if members is None:
                continue
            on_path = is_on_path(*members, has_path=group.get("path") is not None)
            preset = presets_of(*members, on_path=on_path, with_all=True)[section]
        with suppress(ValidationError):
            given = data.get(section)
            if section == "sensors":
                shared = default_sensors() if given is None else parse_sensors(given)
            else:
                shared = parse_section(section, given or {})
            base = _plain(preset_settings(section, str(preset), shared))
            out[section] = merge_nested(base, {key: value for key, value in changes.items() if key != "name"})
    if "sensors" in out:
        out["sensors"] = _sensor_entries(out["sensors"])
    return out


def _plain(settings: Any) -> dict[str, Any]:
    """Settings, or those of sensors by name, as plain data."""
    if isinstance(settings, Mapping):
        return {name: entry.model_dump(mode="json") for name, entry in settings.items()}
    return {} if settings is None else dict(settings.model_dump(mode="json"))


def _sensor_entries(sensors: Any) -> Any:
    """The entries of sensors as `read_entries` has them; faulty ones stay, for the check to report."""
    with suppress(ValueError):
        return read_entries(sensors)
    return sensors


def is_robot_group(group: Any) -> bool:
    """Whether a group, as settings or as plain data, is one of robots."""
    body = group.get("body") if isinstance(group, Mapping) else getattr(group, "body", None)
    name = body.get("name") if isinstance(body, Mapping) else getattr(body, "name", body)
    return name is not None and name not in BODIES.names()


def replace_actors(groups: Mapping[str, Any], actors: Mapping[str, Any]) -> dict[str, Any]:
    """The groups of robots among `groups`, and `actors` in the place of all others."""
    return {**{name: group for name, group in groups.items() if is_robot_group(group)}, **actors}


def change_group(groups: dict[str, Any], path: Sequence[str], value: Any) -> None:
    """Set what is at a path in `groups`: the name of a group, of a setting in it, and so on.

    A setting below the name of an option changes that option: `task: paper` becomes `task: {name: paper,
    ...}`. A mapping changes the one that is there, unless it names another option.
    """
    *parents, leaf = path
    settings = groups
    for depth, part in enumerate(parents):
        after = path[depth + 1]
        inner = settings.get(part)
        if isinstance(inner, Mapping):
            inner = dict(inner)
        else:
            inner = _named(part, inner, {after}) if depth == 1 else inner
            if isinstance(inner, Sequence) and not isinstance(inner, str):
                raise ConfigError("cannot change a setting inside of a list")
            inner = inner if isinstance(inner, dict) else {}
        settings[part] = settings = inner
    before = settings.get(leaf)
    if isinstance(value, Mapping):
        if len(path) == 1 and isinstance(before, Mapping):
            for name, inner in value.items():
                change_group(groups, [leaf, str(name)], inner)
            return
        if len(path) == 2 and "name" not in value:
            before = _named(leaf, before, set(value))
        if isinstance(before, Mapping) and not _names_another(value, before):
            value = merge_nested(before, value)
    settings[leaf] = value


def _named(section: str, value: Any, changed: set[str]) -> Any:
    """The name of an option as settings, which `changed` ones shall join; likewise a list of sensors."""
    if section == "sensors" and isinstance(value, list | tuple):
        return {"enabled": list(value)}
    if section in _NAMED and value is not None and not isinstance(value, Mapping):
        return {"name": str(value)} if changed.isdisjoint(_NAMELESS) else {}
    return value


def _names_another(value: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    if "name" in value:
        return bool(value["name"] != before.get("name"))
    return "name" in before and not _NAMELESS.isdisjoint(value)
