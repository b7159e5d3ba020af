"""Converts checkpoints of format 2 (one policy, flat keys) to format 3 (agent groups)."""

from collections.abc import Mapping
from typing import Any

MIGRATED_VERSION = 2


def migrate_checkpoint(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a policy or checkpoint of format 2 in format 3; `config` is not changed.

    The policy becomes that of the robot's group. When such a run is resumed,
    scenes start new episodes, since their saved state is incompatible.
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
