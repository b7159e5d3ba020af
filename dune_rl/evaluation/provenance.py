"""Where results come from: software, hardware, the command, and the episodes and weights used."""

import os
import platform
import sys
from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import sha256_of
from dune_rl.core.machine import git_commit, memory_gib, package_versions, processor_name
from dune_rl.evaluation.episode_sets.apply import sites_of_training
from dune_rl.evaluation.running import EvaluationPlan
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.sensors.perception.agent_tracks import AgentTracksConf
from dune_rl.sensors.perception.motion_forecast import find_forecast


def describe_provenance(plan: EvaluationPlan) -> dict[str, Any]:
    """Plain data on everything that determines the results of `plan`, or may change them."""
    used, conf = plan.episode_set, plan.conf
    extent: dict[str, Any] = {"episodes": plan.episodes}
    if conf.protocol is not None:
        extent = {"protocol": conf.protocol, "runs": conf.runs, "run_steps": conf.run_steps}
    policies = []
    for source in plan.sources:
        # World seeds of the set that were sites of a checkpoint's training too.
        sites = []
        if used is not None and source.kind == "checkpoint" and source.file is not None:
            sites = sites_of_training(read_policy_file(source.file)[1]["config"], used)
        policies.append(source.plain() | {"sites_of_training": sites})
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": ["python", "-m", "dune_rl.evaluate", *sys.argv[1:]],
        "set": None if used is None else {"name": used.name, "sha256": used.header.sha256},
        "world": conf.world.name,
        "engine": conf.physics.backend,
        "seed": conf.seed,
        **extent,
        "scenes": plan.scenes,
        "processes": conf.processes,
        "policies": policies,
        "forecasts": _forecasts(plan),
        "git": git_commit(),
        "packages": package_versions(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "hardware": {"processor": processor_name(), "cores": os.cpu_count(), "memory_gib": memory_gib()},
    }


def _forecasts(plan: EvaluationPlan) -> dict[str, str]:
    """The SHA-256 of the files by which sensors forecast, by their settings."""
    found = {}
    for group in plan.conf.groups:
        for sensor in (group.sensors or {}).values():
            if isinstance(sensor, AgentTracksConf) and sensor.forecast is not None:
                found[sensor.forecast] = sha256_of(find_forecast(sensor.forecast))
    return found


def check_same_sources(
    plan: EvaluationPlan, provenance: dict[str, Any], path: Path, trusted: Collection[str] = ()
) -> None:
    """Raise ConfigError unless the set and the weights of `plan` are those of the results in `path`.

    Functions of users are refused unless they are `trusted`: importing one runs code, and the folder that
    names it may come from somebody else.
    """
    code = [one.location for one in plan.sources if one.kind == "callable" and one.location not in trusted]
    if code:
        words = code[0] if len(code) == 1 else f"[{','.join(code)}]"
        raise ConfigError(
            f"{path} has results of {' and '.join(code)}, whose code would be run.\n"
            f"If you trust it, add policy={words}"
        )
    forecasts = provenance.get("forecasts")
    if forecasts is not None and forecasts != _forecasts(plan):
        raise ConfigError(
            f"{path} was made with another forecast than that now in {', '.join(forecasts)}; evaluate again"
        )
    used = plan.episode_set
    before, now = provenance.get("set"), None if used is None else used.header.sha256
    if (before or {}).get("sha256") != now:
        raise ConfigError(
            f"{path} was made with another set {plan.conf.set}: its checksum was "
            f"{(before or {}).get('sha256', 'none')[:12]}, and is {(now or 'none')[:12]} now; evaluate again"
        )
    sums = {one["location"]: one["sha256"] for one in provenance["policies"]}
    for source in plan.sources:
        try:
            found = source.plain()["sha256"]
        except ConfigError as error:
            raise ConfigError(f"{error}; run the command in the folder where {path.name} was made") from None
        if sums.get(source.location) != found:
            raise ConfigError(
                f"{path} was made with other weights than those now in {source.location}; evaluate again"
            )
