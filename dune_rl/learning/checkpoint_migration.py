"""Files of format 2, of one policy with flat keys, as files of format 3, of agent groups."""

from collections.abc import Mapping
from typing import Any

MIGRATED_VERSION = 2


def migrate(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a policy or a checkpoint of format 2 as format 3 has it; `config` is left as it is.

    The group has the name that the robot's group has now. Scenes start new
    episodes when such a run is resumed, since their state has another form.
    """
    group = _group_name(content["config"])
    entry: dict[str, Any] = {
        "algorithm": "sac",
        "spec": content["layout"],
        "network": content["architecture"],
    }
    moved = ("layout", "architecture", "policy", "learner", "replay")
    rest = {key: value for key, value in content.items() if key not in moved}
    if content["kind"] == "policy":
        return {**rest, "groups": {group: {**entry, "policy": content["policy"]}}}
    counters = dict(content["counters"])
    learner = {
        **content["learner"],
        "updates": counters.pop("updates"),
        "updates_due": counters.pop("updates_due"),
    }
    recent = dict(content["log"])
    history = recent.pop("history")
    counters["best_score"] = counters.pop("best_success")
    return {
        **rest,
        "groups": {group: {**entry, "learner": learner, "experience": content["replay"]}},
        "counters": counters,
        "collector": {**content["collector"], "state": None},
        "log": {"recent": {group: recent}, "history": history},
    }


def _group_name(config: Mapping[str, Any]) -> str:
    name = config.get("robot", {}).get("name", "rover_zero")
    return "rover" if name == "rover_zero" else str(name)
