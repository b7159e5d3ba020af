"""Changes of agent groups by overrides and in Python: of those that options compose, and of a saved run's."""

import re
from collections.abc import Mapping
from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from dune_rl.config.group_options import SCENARIO
from dune_rl.config.hydra_session import to_plain
from dune_rl.config.overrides import ParsedOverrides
from dune_rl.config.shorthands import change_group, is_robot_group
from dune_rl.core.errors import ConfigError


def change_groups(
    data: dict[str, Any], section: str, request: ParsedOverrides, changes: Mapping[str, Any]
) -> None:
    """Apply the changes of single groups, and of settings in them, to a section of agent groups."""
    groups = data.get(section) or {}
    wanted = [(str(each.key_or_group).split(".")[1:], each) for each in request.group_changes]
    wanted = [(path, each) for path, each in wanted if str(each.key_or_group).startswith(f"{section}.")]
    replacing = changes.get(section, {})
    if not isinstance(replacing, Mapping):
        groups = replacing
    if not isinstance(groups, Mapping):
        data[section] = groups
        return
    groups = dict(groups)
    for path, each in wanted:
        try:
            change_group(groups, path, _value_of(each, data))
        except ConfigError as error:
            words = " ".join(str(each.input_line) for _, each in wanted)
            raise ConfigError(f"{error}; write the whole value, or one of the two: {words}") from None
    for name, value in replacing.items() if isinstance(replacing, Mapping) else ():
        change_group(groups, [str(name)], value)
    if groups:
        data[section] = groups


def _value_of(override: Override, data: Mapping[str, Any]) -> Any:
    """The value of an override, with interpolations resolved."""
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
    robots = {name: group for name, group in saved.items() if is_robot_group(group)}
    actors = {name: group for name, group in saved.items() if name not in robots}
    origins: dict[str, str] = {}
    if chosen & {"robot", "robots"}:
        robots = {name: group for name, group in fresh.items() if is_robot_group(group)}
    else:
        changed = [each for each in request.values if str(each.key_or_group).startswith("robot.")]
        for override in changed:
            if len(robots) > 1:
                raise ConfigError(
                    f"{override.input_line}: there are the robots {', '.join(robots)}; write agents.NAME.body"
                )
            (name,) = robots
            change_group(robots, [name, "body", *str(override.key_or_group).split(".")[1:]], override.value())
            origins[f"agents.{name}.body"] = "robot"
    if chosen & {"actors", SCENARIO}:
        actors = {name: group for name, group in fresh.items() if not is_robot_group(group)}
    else:
        for override in request.group_changes:
            section, *path = str(override.key_or_group).split(".")
            if section == "actors":
                change_group(actors, path, override.value())
    origins |= {f"agents.{name}": f"actors.{name}" for name in request.named_in("actors")}
    return {**robots, **actors}, origins


def name_shorthands(message: str, origins: Mapping[str, str]) -> str:
    """An error's message, in which paths in `agents` are those of the shorthands that wrote there."""
    for path, origin in sorted(origins.items(), key=lambda item: -len(item[0])):
        message = re.sub(rf"(?<![\w.]){re.escape(path)}(?!\w)", origin, message)
    return message
