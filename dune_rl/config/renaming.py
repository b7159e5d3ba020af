"""Settings under their older names: which they were, and what their values become."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from dune_rl.core.errors import DuneWarning


def _same(value: Any) -> Any:
    return value


def _degrees(value: Any) -> Any:
    """An angle in degrees, rounded so that 1.4835298641951802 rad are 85; every number of a distribution."""
    if isinstance(value, Mapping):
        return {key: _degrees(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_degrees(inner) for inner in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return round(math.degrees(value), 9) if is_number else value


@dataclass(frozen=True)
class Renaming:
    """A setting's old path in its section, its new ones, and what its value becomes.

    One that reads well under its old name, too, is not warned of: `quiet`.
    """

    old: str
    new: tuple[str, ...]
    convert: Callable[[Any], Any] = _same
    quiet: bool = False


def _renaming(old: str, *new: str, convert: Callable[[Any], Any] = _same, quiet: bool = False) -> Renaming:
    return Renaming(old, new, convert, quiet)


def _angles(*paths: str) -> tuple[Renaming, ...]:
    """Angles that were `PATH_rad`."""
    return tuple(_renaming(f"{path}_rad", f"{path}_deg", convert=_degrees) for path in paths)


_TASK = (
    _renaming("reward.alpha", "rewards.distance.weight", "rewards.heading.weight"),
    _renaming("reward.distance_scale", "rewards.distance.scale"),
    _renaming("reward.min_progress_m", "rewards.distance.min_progress_m"),
    _renaming("reward.signed_progress", "rewards.distance.signed"),
    _renaming("reward.heading_limit_rad", "rewards.distance.heading_limit_deg", convert=_degrees),
    _renaming("reward.misaligned", "rewards.distance.misaligned"),
    _renaming("reward.heading_bonus", "rewards.heading.bonus"),
    _renaming("reward.velocity_scale", "rewards.velocity.speed_scale"),
    _renaming("reward.turn_scale", "rewards.velocity.turn_scale"),
    _renaming("reward.goal", "rewards.goal.weight"),
    _renaming("reward.collision", "rewards.collision.weight"),
    _renaming("reward.collision_distance_m", "rewards.collision.distance_m"),
    _renaming("reward.contact", "rewards.contact.weight"),
    _renaming("reward.stuck", "rewards.stuck.weight"),
    _renaming("reward.flipped", "rewards.flipped.weight"),
    _renaming("reward.out_of_world", "rewards.out_of_world.weight"),
    _renaming("termination.goal_distance_m", "terminations.goal_reached.distance_m"),
    _renaming("termination.max_steps", "terminations.time_limit.max_steps", quiet=True),
    _renaming("termination.stuck_distance_m", "terminations.stuck.distance_m"),
    _renaming("termination.stuck_steps", "terminations.stuck.steps"),
    _renaming("termination.flipped_rad", "terminations.flipped.angle_deg", convert=_degrees),
    _renaming("termination.continue_after_goal", "terminations.goal_reached.renew"),
)
_METRICS = (
    _renaming(
        "max_clearance_m",
        *(f"terms.{name}.{key}" for name in ("clearance", "min_clearance") for key in ("max_m", "initial")),
    ),
    _renaming("uneven_tilt_rad", "terms.vort.uneven_tilt_deg", convert=_degrees),
)
_ROBOT = (
    *_angles("mounts.camera_pitch"),
    _renaming("gait.careful_from_rad", "gait.slow_from_tilt_deg", convert=_degrees),
    _renaming("gait.careful_to_rad", "gait.slow_to_tilt_deg", convert=_degrees),
    _renaming("gait.careful_share", "gait.slow_speed_share"),
)

# By the kind of the sensor: those of `named` are found by theirs.
_OF_SENSORS = {
    "lidar": _angles("fov"),
    "lidar_3d": _angles("fov", "lowest_elevation", "highest_elevation"),
    "depth_strip": _angles("fov", "lowest_elevation", "highest_elevation"),
    "camera": _angles("fov", "pitch"),
}
_SENSORS = tuple(
    replace(each, old=f"{kind}.{each.old}", new=tuple(f"{kind}.{new}" for new in each.new))
    for kind, renamings in _OF_SENSORS.items()
    for each in renamings
)

# The renamed settings of each section of an environment's settings.
RENAMED: Mapping[str, tuple[Renaming, ...]] = {
    "task": _TASK,
    "metrics": _METRICS,
    "robot": _ROBOT,
    "sensors": _SENSORS,
    "world": (_renaming("things_per_100m2", "props_per_100m2"),),
    "weather": _angles("light.sun_bearing", "light.sun_elevation"),
    "randomisation": _angles("sun_bearing", "sun_elevation"),
}


def rename_in_section(section: str, settings: Any, path: str, *, warn: bool) -> None:
    """Move the settings of a section that have an old name to their new places; `path` is where it stands.

    Anything but a dictionary is left as it is.
    """
    if not isinstance(settings, dict):
        return
    for each in RENAMED[section]:
        _move(settings, path, each, warn=warn)
    named = settings.get("named") if section == "sensors" else None
    for name, sensor in named.items() if isinstance(named, dict) else ():
        if isinstance(sensor, dict):
            for each in _OF_SENSORS.get(str(sensor.get("sensor", name)), ()):
                _move(sensor, f"{path}.named.{name}", each, warn=warn)


def put(data: dict[str, Any], path: str, value: Any) -> None:
    """Set what is at a dotted path; a mapping without a `name` of its own changes the one that is there."""
    *parents, leaf = path.split(".")
    for parent in parents:
        if not isinstance(data.get(parent), dict):
            data[parent] = {}
        data = data[parent]
    there = data.get(leaf)
    if isinstance(value, Mapping) and isinstance(there, Mapping) and "name" not in value:
        value = {**there, **value}
    data[leaf] = value


def tell(message: str) -> None:
    """Warn of a setting under an older name."""
    warnings.warn(message, DuneWarning, stacklevel=2)


def _move(settings: dict[str, Any], path: str, renaming: Renaming, *, warn: bool) -> None:
    *parents, leaf = renaming.old.split(".")
    holders: list[dict[str, Any]] = [settings]
    for parent in parents:
        inner = holders[-1].get(parent)
        if not isinstance(inner, dict):
            return
        holders.append(inner)
    if leaf not in holders[-1]:
        return
    value = renaming.convert(holders[-1].pop(leaf))
    for parent, holder in zip(reversed(parents), reversed(holders[:-1]), strict=True):
        if not holder[parent]:
            del holder[parent]
    for new in renaming.new:
        put(settings, new, value)
    if warn and not renaming.quiet:
        named = " and ".join(f"{path}.{new}" for new in renaming.new)
        tell(f"{path}.{renaming.old} is now {named}")
