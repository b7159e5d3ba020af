"""Settings of runs and evaluations that were saved before release 0.1.0, in the form of this version."""

import math
from collections.abc import Mapping
from typing import Any

from dune_rl.config.agents import SECTIONS
from dune_rl.config.shorthands import is_robot_group, join_groups, write_agents
from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import copy_nested
from dune_rl.core.untrusted_files import first_line
from dune_rl.sensors.conf import complete_entries
from dune_rl.tasks.task import TaskConf

# Sections whose angles were in radians, under names that ended in `_rad`.
_SECTIONS_OF_ANGLES = ("sensors", "weather", "randomisation")


def upgrade_saved(saved: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a saved run or evaluation, in the form of this version.

    The published runs of `experiments/` are in all older forms there are. Those of `experiments/flat` had the
    default rewards, terminations and metrics, which they state under older names. Raises ConfigError for what
    are no such settings.
    """
    try:
        return _upgrade(copy_nested(saved))
    except ConfigError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ConfigError(
            f"the settings in the file are damaged ({type(error).__name__}: {first_line(error)}); "
            "give another file of the run's folder"
        ) from error


def _upgrade(data: dict[str, Any]) -> dict[str, Any]:
    task, metrics, learning = data.get("task"), data.get("metrics"), data.get("learning")
    if isinstance(task, dict) and "reward" in task:
        data["task"] = TaskConf.model_validate({"spawn": task.get("spawn", {})}).model_dump(mode="json")
    if isinstance(metrics, dict) and "terms" not in metrics:
        del data["metrics"]
    if isinstance(learning, dict):
        learning.setdefault("name", "sac")
    for section in _SECTIONS_OF_ANGLES:
        if section in data:
            data[section] = _in_degrees(data[section])
    for place in (data, *_groups(data)):
        if isinstance(place.get("sensors"), dict) and "enabled" in place["sensors"]:
            place["sensors"] = _sensors_by_name(place["sensors"])
        _without_gap_errors(place.get("sensors"))
    return write_agents(data)


def split_groups(config: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The groups of robots in saved settings of any form, and the others, with what they state themselves."""
    if not config.get("agents") and "robot" not in config:
        return {}, {}
    robots: dict[str, Any] = {}
    actors: dict[str, Any] = {}
    for name, group in join_groups(config)[0]["agents"].items():
        own = {
            key: value for key, value in group.items() if key not in SECTIONS or isinstance(value, Mapping)
        }
        (robots if is_robot_group(group) else actors)[name] = own
    return robots, actors


def robot_names(config: Mapping[str, Any]) -> list[str]:
    """The names of the robots in saved settings of any form, sorted."""
    bodies = (group.get("body") for group in split_groups(config)[0].values())
    return sorted({str(body["name"]) for body in bodies if isinstance(body, Mapping) and "name" in body})


def _groups(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    sections = [data.get(name) for name in ("agents", "actors")]
    return [group for groups in sections if isinstance(groups, dict) for group in groups.values()]


def _without_gap_errors(sensors: Any) -> None:
    """Leave the gaps of a look ahead exact where its settings are from before they could be uncertain."""
    for sensor in sensors.values() if isinstance(sensors, dict) else ():
        if isinstance(sensor, dict) and sensor.get("sensor") == "command_costs":
            sensor.setdefault("gap_error_m", 0.0)
            sensor.setdefault("gap_error_growth_mps", 0.0)


def _sensors_by_name(old: Mapping[str, Any]) -> dict[str, Any]:
    """Sensors by name, from a list `enabled` beside the settings of each kind, `named` ones and `realism`."""
    entries = {**old, **old.get("named", {})}
    realism, past_s = entries.pop("realism", {}), entries.pop("past_s", 0.5)
    entries |= {name: {} for name, faults in realism.items() if faults is not None and name not in entries}
    entries.pop("named", None)
    for name in old["enabled"]:
        if name.endswith("_past"):
            entries[name] = {"sensor": "lidar_past", "lidar": name.removesuffix("_past"), "past_s": past_s}
    found: dict[str, Any] = complete_entries(entries)
    for name, faults in realism.items():
        if faults is not None:
            found[name]["realism"] = faults
    return found


def _in_degrees(settings: Any) -> Any:
    """Nested settings, in which every angle `NAME_rad` is `NAME_deg`, but for those of grids of commands."""
    if not isinstance(settings, dict):
        return settings
    found: dict[str, Any] = {}
    for key, value in settings.items():
        if key == "commands":
            found[key] = value
            continue
        name = key.removesuffix("_rad")
        found |= {key: _in_degrees(value)} if name == key else {f"{name}_deg": _degrees(value)}
    return found


def _degrees(value: Any) -> Any:
    """An angle in degrees, rounded so that 1.4835298641951802 rad are 85; every number of a distribution."""
    if isinstance(value, dict):
        return {key: _degrees(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_degrees(inner) for inner in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return round(math.degrees(value), 9) if is_number else value
