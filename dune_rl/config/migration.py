"""Settings under their older names: in overrides, in Python and in the settings of older runs."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from dune_rl.config.actors import groups_of_list
from dune_rl.config.agents import EXTERNAL, PERSON
from dune_rl.config.expand import merged
from dune_rl.errors import DuneWarning
from dune_rl.metrics.episode import MetricsConf
from dune_rl.tasks.task import TaskConf, walking_task


def _same(value: Any) -> Any:
    return value


def _degrees(value: Any) -> Any:
    """An angle in degrees, rounded so that 1.4835298641951802 rad are 85."""
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
    _renaming("mounts.camera_pitch_rad", "mounts.camera_pitch_deg", convert=_degrees),
    _renaming("gait.careful_from_rad", "gait.slow_from_tilt_deg", convert=_degrees),
    _renaming("gait.careful_to_rad", "gait.slow_to_tilt_deg", convert=_degrees),
    _renaming("gait.careful_share", "gait.slow_speed_share"),
)

# The renamed settings of each section of an environment's settings.
RENAMED: Mapping[str, tuple[Renaming, ...]] = {"task": _TASK, "metrics": _METRICS, "robot": _ROBOT}
_WALKING = {
    "progress_scale": "progress.weight",
    "near_miss": "near_miss.weight",
    "comfort_m": "near_miss.comfort_m",
}


def move_renamed(data: dict[str, Any], *, warn: bool = True) -> None:
    """Move the settings in `data` that have an old name to their new places; with `warn`, say so."""
    for section, renamings in RENAMED.items():
        if isinstance(data.get(section), dict):
            for each in renamings:
                _move(data, section, each, warn=warn)
    _move_walking(data, warn=warn)


def migrated(saved: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a run that may be older, as this version has them."""
    data = _copied(saved)
    task, metrics = data.get("task"), data.get("metrics")
    if isinstance(task, dict) and "reward" in task:
        # It states every setting that there was; those that there was not have their defaults.
        data["task"] = merged(TaskConf().model_dump(mode="json"), task)
    if isinstance(metrics, dict) and "terms" not in metrics:
        data["metrics"] = merged(MetricsConf().model_dump(mode="json"), metrics)
    if isinstance(data.get("actors"), list):
        data["actors"] = groups_of_list(data["actors"])
    if isinstance(data.get("learning"), dict):
        data["learning"].setdefault("name", "sac")
    move_renamed(data, warn=False)
    return data


def _move(data: dict[str, Any], section: str, renaming: Renaming, *, warn: bool) -> None:
    *parents, leaf = renaming.old.split(".")
    holders: list[dict[str, Any]] = [data[section]]
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
        _put(data[section], new, value)
    if warn and not renaming.quiet:
        named = " and ".join(f"{section}.{new}" for new in renaming.new)
        _warn(f"{section}.{renaming.old} is now {named}")


def _move_walking(data: dict[str, Any], *, warn: bool) -> None:
    """The rewards of walkers were settings of the one task; now they are of the walkers' own."""
    task = data.get("task")
    walking = task.pop("walking", None) if isinstance(task, dict) else None
    if not isinstance(walking, dict):
        return
    base = walking_task().model_dump(mode="json")
    rewards: dict[str, Any] = {}
    for old, new in _WALKING.items():
        if old in walking:
            _put(rewards, new, walking.pop(old))
    if walking:
        # Nothing that there ever was: the check says so.
        data["task"]["walking"] = walking
    if not rewards or merged(base["rewards"], rewards) == base["rewards"]:
        return
    for name, group in _external_persons(data):
        group["task"] = merged(group.get("task") or base, {"rewards": rewards})
        if warn:
            _warn(f"task.walking is now {name}.task.rewards")


def _external_persons(data: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    found = []
    for section in ("actors", "agents"):
        groups = data.get(section)
        for name, group in groups.items() if isinstance(groups, dict) else ():
            body = group.get("body") if isinstance(group, dict) else None
            is_person = body == PERSON or (isinstance(body, dict) and body.get("name") == PERSON)
            if is_person and group.get("controller", EXTERNAL) == EXTERNAL:
                found.append((f"{section}.{name}", group))
    return found


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    *parents, leaf = path.split(".")
    for parent in parents:
        data = data.setdefault(parent, {})
    data[leaf] = value


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copied(inner) for key, inner in value.items()}
    return [_copied(inner) for inner in value] if isinstance(value, list | tuple) else value


def _warn(message: str) -> None:
    warnings.warn(message, DuneWarning, stacklevel=2)
