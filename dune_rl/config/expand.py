"""Names of options inside settings, as in `robots=[leo_rover]` and `agents={rover: {task: paper}}`."""

from collections.abc import Mapping, Sequence
from typing import Any

from hydra import compose as hydra_compose
from hydra.core.config_loader import ConfigLoader
from omegaconf import OmegaConf

from dune_rl.config.actors import groups_of_list
from dune_rl.config.overrides import option_names
from dune_rl.suggestions import closest, one_of

# Sections of an agent group that may name an option of the group of this name.
_SECTIONS = ("sensors", "task", "metrics")


def expand_options(data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """Put the settings of options in the place of their names in `data`; the faults in the names.

    A robot of `robots`, and a group's `body`, `sensors`, `task` and `metrics`,
    are the name of an option, or a mapping with its `name` and the values that
    differ. A list of sensors is what is enabled, and a list of actors becomes
    groups. What has no known name is left out, so that the rest is checked.
    """
    faults = _expand_robots(data, loader)
    if isinstance(actors := data.get("actors"), Sequence) and not isinstance(actors, str):
        data["actors"] = groups_of_list(actors)
    for section in ("agents", "actors"):
        groups = data.get(section)
        if isinstance(groups, Mapping):
            data[section] = {
                name: _expanded_group(group, f"{section}.{name}", loader, faults)
                for name, group in groups.items()
            }
    return faults


def merged(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with nested `changes`; mappings merge, everything else replaces."""
    out = dict(data)
    for name, value in changes.items():
        inner = out.get(name)
        if isinstance(value, Mapping) and isinstance(inner, Mapping):
            out[name] = merged(inner, value)
        else:
            out[name] = value
    return out


def _expand_robots(data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    robots = data.get("robots")
    if not isinstance(robots, list):
        return []
    options = option_names(loader, "robot")
    chosen: list[Any] = []
    faults: list[str] = []
    for robot in robots:
        changes = robot if isinstance(robot, Mapping) else {"name": robot}
        name = changes.get("name")
        if name in options:
            chosen.append(_changed_option("robot", name, changes))
        elif name is None:
            faults.append(f"robots: each is a name or has one: choose {one_of(options)} (got {robot!r})")
        else:
            faults.append(f"there is no robot {name!r}; choose {one_of(options)}")
    data["robots"] = chosen or (None if faults else [])
    return faults


def _expanded_group(group: Any, path: str, loader: ConfigLoader, faults: list[str]) -> Any:
    if not isinstance(group, Mapping):
        return group
    out = dict(group)
    body = {"name": group["body"]} if isinstance(group.get("body"), str) else group.get("body")
    # Persons, and robots of users' packages, are known to the schema alone.
    if isinstance(body, Mapping) and body.get("name") in option_names(loader, "robot"):
        out["body"] = _changed_option("robot", str(body["name"]), body)
    for section in _SECTIONS:
        value = group.get(section)
        if section == "sensors" and isinstance(value, Sequence) and not isinstance(value, str):
            out[section] = {"enabled": list(value)}
            continue
        changes = {"name": value} if isinstance(value, str) else value
        if isinstance(changes, Mapping) and isinstance(name := changes.get("name"), str):
            options = option_names(loader, section)
            if name in options:
                out[section] = _changed_option(section, name, changes)
            else:
                near = closest(name, options)
                remedy = f"did you mean {near}?" if near else f"choose {one_of(options)}"
                faults.append(f"{path}.{section}: there is no {section} {name!r}; {remedy}")
                out[section] = None
    return out


def _changed_option(group: str, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of an option with `changes`, but for the name, which need not be that of its file."""
    settings = OmegaConf.to_container(hydra_compose("environment", [f"{group}={name}"])[group], resolve=True)
    assert isinstance(settings, dict)
    stated = {str(key): value for key, value in settings.items()}
    return merged(stated, {key: value for key, value in changes.items() if key != "name"})
