"""Settings of older versions as this one has them: in overrides, in Python and in saved runs."""

from collections.abc import Iterator, Mapping
from typing import Any

from dune_rl.config.actors import groups_of_list
from dune_rl.config.agents import PERSON
from dune_rl.config.controller_settings import EXTERNAL
from dune_rl.config.expand import merged
from dune_rl.config.renaming import RENAMED, put, rename_in_section, tell
from dune_rl.metrics.episode import MetricsConf
from dune_rl.tasks.task import TaskConf, walking_task

_WALKING = {
    "progress_scale": "progress.weight",
    "near_miss": "near_miss.weight",
    "comfort_m": "near_miss.comfort_m",
}


def move_renamed(data: dict[str, Any], *, warn: bool = True) -> None:
    """Move the settings in `data` that have an old name to their new places; with `warn`, say so."""
    for section, settings, path in _sections(data):
        rename_in_section(section, settings, path, warn=warn)
    _move_walking(data, warn=warn)


def migrated(saved: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a run that may be older, as this version has them."""
    data = copied(saved)
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
    for section, settings, _ in _sections(data):
        if section == "robot":
            _keep_skid_steer(settings)
    return data


def _keep_skid_steer(robot: Any) -> None:
    """Keep a URDF's robot on the drive that it was trained with, when there was no other."""
    drive = robot.get("drive") if isinstance(robot, dict) and robot.get("name") == "urdf" else None
    if isinstance(drive, dict) and "kind" not in drive:
        drive["kind"] = "skid_steer"
        robot.setdefault("free_joints", [])


def _sections(data: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
    """Each section whose settings have older names, with its settings and where they stand."""
    for section in RENAMED:
        yield section, data.get(section), section
    robots = data.get("robots")
    for number, robot in enumerate(robots if isinstance(robots, list) else ()):
        yield "robot", robot, f"robots.{number}"
    for path, group in _groups(data):
        yield "robot", group.get("body"), f"{path}.body"
        for section in ("sensors", "task", "metrics"):
            yield section, group.get(section), f"{path}.{section}"


def _groups(data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The agent groups, each with its path."""
    for section in ("actors", "agents"):
        groups = data.get(section)
        for name, group in groups.items() if isinstance(groups, dict) else ():
            if isinstance(group, dict):
                yield f"{section}.{name}", group


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
            put(rewards, new, walking.pop(old))
    if walking:
        # Nothing that there ever was: the check says so.
        data["task"]["walking"] = walking
    if not rewards or merged(base["rewards"], rewards) == base["rewards"]:
        return
    for name, group in _external_persons(data):
        group["task"] = merged(group.get("task") or base, {"rewards": rewards})
        if warn:
            tell(f"task.walking is now {name}.task.rewards")


def _external_persons(data: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    found = []
    for path, group in _groups(data):
        body = group.get("body")
        is_person = body == PERSON or (isinstance(body, dict) and body.get("name") == PERSON)
        if is_person and group.get("controller", EXTERNAL) == EXTERNAL:
            found.append((path, group))
    return found


def copied(value: Any) -> Any:
    """Nested mappings and lists, copied as dictionaries and lists."""
    if isinstance(value, Mapping):
        return {key: copied(inner) for key, inner in value.items()}
    return [copied(inner) for inner in value] if isinstance(value, list | tuple) else value
