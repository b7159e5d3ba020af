"""Names of options inside settings, as in `robots=[leo_rover]` and `agents={rover: {task: paper}}`."""

from collections.abc import Mapping, Sequence
from typing import Any

from hydra.core.config_loader import ConfigLoader
from omegaconf import OmegaConf

from dune_rl.bodies.person import PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.config.actors import groups_of_list
from dune_rl.config.controller_settings import EXTERNAL, PATH, TRAJECTORY, plain_controller
from dune_rl.config.hydra_session import compose_words
from dune_rl.config.overrides import option_names
from dune_rl.config.resolved_groups import roaming_settings
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import closest, one_of
from dune_rl.metrics.episode import MetricsConf
from dune_rl.sensors.conf import SensorsConf
from dune_rl.tasks.task import TaskConf

# Sections of an agent group that may name an option of the group of this name, with their settings.
_SECTIONS: dict[str, type[Settings]] = {"sensors": SensorsConf, "task": TaskConf, "metrics": MetricsConf}
# The options that persons and other kinematic bodies have unless their group says otherwise.
_OF_BODIES = {"sensors": "walker"}
_OF_WALKERS = {"sensors": "walker", "task": "walking"}


class _OptionReader:
    """The options of Hydra's groups and their settings, each read once."""

    def __init__(self, loader: ConfigLoader) -> None:
        self._loader = loader
        self._names: dict[str, list[str]] = {}
        self._settings: dict[tuple[str, str], dict[str, Any]] = {}

    def names(self, group: str) -> list[str]:
        """The options of a group, sorted."""
        if group not in self._names:
            self._names[group] = option_names(self._loader, group)
        return self._names[group]

    def changed(self, group: str, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of an option with `changes`, but for the name, which need not be that of its file."""
        if (group, name) not in self._settings:
            composed = OmegaConf.to_container(compose_words(f"{group}/{name}")[group], resolve=True)
            assert isinstance(composed, dict)
            settings = {str(key): value for key, value in composed.items()}
            self._settings[group, name] = settings
        return merged(
            self._settings[group, name], {key: value for key, value in changes.items() if key != "name"}
        )


def expand_options(data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """Put the settings of options in the place of their names in `data`; the faults in the names.

    A robot of `robots`, and a group's `body`, `sensors`, `task` and `metrics`,
    are the name of an option, or a mapping with its `name` and the values that
    differ. A group's `sensors`, `task` and `metrics` without a name are what
    differs from those that it has otherwise (see `resolve_groups`), unless they
    have all settings, as in a saved run. A list of sensors is what is enabled,
    and a list of actors becomes groups. What has no known name is left out, so
    that the rest is checked.
    """
    options = _OptionReader(loader)
    faults = _expand_robots(data, options)
    if isinstance(actors := data.get("actors"), Sequence) and not isinstance(actors, str):
        data["actors"] = groups_of_list(actors)
    for section in ("agents", "actors"):
        groups = data.get(section)
        if isinstance(groups, Mapping):
            groups = {str(name): group for name, group in groups.items()}
            data[section] = {
                name: _expanded_group(group, f"{section}.{name}", data, options, faults)
                for name, group in groups.items()
                if not name.isdigit()
            }
            names = one_of(data[section]) if data[section] else "that of a group"
            faults += [
                f"{section}.{name}: agent groups have names, not numbers; write {names} for {name}"
                for name in groups
                if name.isdigit()
            ]
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


def _expand_robots(data: dict[str, Any], options: _OptionReader) -> list[str]:
    robots = data.get("robots")
    if not isinstance(robots, list):
        return []
    names = options.names("robot")
    chosen: list[Any] = []
    faults: list[str] = []
    for robot in robots:
        changes = robot if isinstance(robot, Mapping) else {"name": robot}
        name = changes.get("name")
        if name in names:
            chosen.append(options.changed("robot", name, changes))
        elif name is None:
            faults.append(f"robots: each is a name or has one: choose {one_of(names)} (got {robot!r})")
        else:
            faults.append(f"there is no robot {name!r}; choose {one_of(names)}")
    data["robots"] = chosen or (None if faults else [])
    return faults


def _options_of(body: Any, group: Mapping[Any, Any]) -> Mapping[str, str]:
    """The options that a group with this body has unless it says otherwise, by section."""
    name = body.get("name") if isinstance(body, Mapping) else None
    if not isinstance(name, str) or name not in BODIES.names():
        return {}
    known = BODIES.settings_class(name) if BODIES.is_loaded(name) else None
    is_person = known is not None and issubclass(known, PersonConf)
    controller = group.get("controller")
    follows = isinstance(controller, Mapping) and TRAJECTORY in controller
    walks = controller in (PATH, TRAJECTORY) or follows or group.get("path") is not None
    return _OF_WALKERS if is_person or walks else _OF_BODIES


def _expanded_group(
    group: Any, path: str, data: Mapping[str, Any], options: _OptionReader, faults: list[str]
) -> Any:
    if not isinstance(group, Mapping):
        return group
    out = dict(group)
    if "controller" in group:
        out["controller"] = plain_controller(group["controller"])
    body = {"name": group["body"]} if isinstance(group.get("body"), str) else group.get("body")
    # Persons, and robots of users' packages, are known to the schema alone.
    if isinstance(body, Mapping) and body.get("name") in options.names("robot"):
        out["body"] = options.changed("robot", str(body["name"]), body)
    own_options = _options_of(body, out)
    for section, settings in _SECTIONS.items():
        value = group.get(section)
        if section == "sensors" and isinstance(value, Sequence) and not isinstance(value, str):
            value = {"enabled": list(value)}
        changes = {"name": value} if isinstance(value, str) else value
        if isinstance(changes, Mapping) and isinstance(name := changes.get("name"), str):
            known = options.names(section)
            if name in known:
                out[section] = options.changed(section, name, changes)
            else:
                near = closest(name, known)
                remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
                faults.append(f"{path}.{section}: there is no {section} {name!r}; {remedy}")
                out[section] = None
        elif isinstance(changes, Mapping) and not settings.model_fields.keys() <= changes.keys():
            if section in own_options:
                out[section] = options.changed(section, own_options[section], changes)
            elif isinstance(base := data.get(section), Mapping):
                is_roaming = section == "task" and out.get("controller", EXTERNAL) != EXTERNAL
                out[section] = merged(roaming_settings(base) if is_roaming else base, changes)
    return out
