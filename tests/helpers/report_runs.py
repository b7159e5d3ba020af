"""Small folders of runs, evaluations and sweeps, as the commands write them, for tests of reports."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from dune_rl.core.seeding import stream
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.inputs import EvaluationRun
from dune_rl.reporting.reading import installed_version

METRICS = ("success", "reached", "collisions", "time_to_goal", "clearance", "vort", "smoothness")
CONFIG: dict[str, Any] = {
    "world": {"name": "flat", "seed": 3},
    "robot": {"name": "rover_zero"},
    "physics": {"backend": "bullet"},
    "task": {"spawn": {"region": "world"}, "terminations": {}, "rewards": {}},
    "metrics": {"terms": {"vort": {"term": "vort", "uneven_tilt_deg": 5.0}}},
}


def write_rows(file: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """A CSV with the columns of all rows."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with file.open("w", newline="", encoding="utf-8") as opened:
        writer = csv.DictWriter(opened, names, restval="")
        writer.writeheader()
        writer.writerows(rows)


def episode_rows(
    policy: str, episodes: int, *, share: float = 0.5, agents: int = 1, **more: object
) -> list[dict[str, object]]:
    """Rows of a policy that succeeds in the first `share` of its episodes."""
    drawn = stream(0, policy, episodes)
    rows: list[dict[str, object]] = []
    for episode in range(episodes):
        for agent in range(agents):
            success = int(episode < share * episodes)
            rows.append(
                {
                    "policy": policy,
                    "world": "flat",
                    "seed": 5,
                    "agent": f"rover_{agent}",
                    "episode": episode,
                    "steps": 40 + episode,
                    "return": float(drawn.normal()),
                    "success": success,
                    "reached": success,
                    "collisions": 1 - success,
                    "time_to_goal": 4.0 + float(drawn.random()) if success else "nan",
                    "clearance": 1.0 + float(drawn.random()),
                    "vort": float(drawn.random()),
                    "smoothness": 2.0 + float(drawn.random()),
                    "start_x_m": 0.0,
                    "start_y_m": 0.0,
                    "goal_x_m": 3.0,
                    "goal_y_m": 4.0,
                    "set": "",
                    "engine": "bullet",
                    **more,
                }
            )
    return rows


def write_evaluation(
    folder: Path,
    rows: Sequence[Mapping[str, object]],
    *,
    config: Mapping[str, Any] = CONFIG,
    **provenance: Any,
) -> Path:
    """A finished evaluation with these rows; `provenance` changes what provenance.json says."""
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(dict(config)))
    write_rows(folder / "episodes.csv", rows)
    policies = list(dict.fromkeys(str(row["policy"]) for row in rows))
    told = {
        "created": "2026-01-02T03:04:05+00:00",
        "command": ["evaluate", "policy=x"],
        "set": None,
        "policies": [{"name": name, "location": name, "sha256": None} for name in policies],
        "git": {"commit": "0123456789abcdef", "changed": False},
        "packages": {"dune_rl": installed_version()},
        "hardware": {"processor": "a processor", "cores": 2},
        "episodes": len({row["episode"] for row in rows}),
        "complete": True,
        "finished": len(rows),
    }
    (folder / "provenance.json").write_text(json.dumps({**told, **provenance}))
    return folder


def write_training(folder: Path, seed: int, *, frames: int = 3_000, **settings: Any) -> Path:
    """A finished training run with three evaluations."""
    folder.mkdir(parents=True)
    config = {**CONFIG, "seed": seed, "run_dir": str(folder), "total_frames": 3_000, "objective": "success"}
    (folder / "config.yaml").write_text(yaml.safe_dump({**config, **settings}))
    rows: list[dict[str, object]] = []
    for number in range(1, 4):
        share = 0.2 * number + 0.01 * seed
        at = number * frames // 3
        common = {"frames": at, "updates": at // 2, "SR": share, "TR": share, "return": 10.0 * number}
        rows += [
            {"kind": "train", "episodes": 100, **common},
            {"kind": "eval", "episodes": 10, **common},
        ]
    write_rows(folder / "metrics.csv", rows)
    return folder


def write_sweep(folder: Path, rates: Sequence[str], *, direction: str | None = None) -> Path:
    """A sweep over learning.gamma whose later jobs do better; the last has not begun."""
    for number, rate in enumerate(rates):
        job = folder / f"{number}_flat_seed{number + 1}"
        if number < len(rates) - 1:
            write_training(job, number + 1)
        (job / ".hydra").mkdir(parents=True)
        words = ["+world=flat", f"learning.gamma={rate}"]
        (job / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(words))
        hydra = {"mode": "MULTIRUN", "sweeper": {"direction": direction} if direction else {}}
        (job / ".hydra" / "hydra.yaml").write_text(yaml.safe_dump({"hydra": hydra}))
    (folder / "multirun.yaml").write_text("hydra: {}\n")
    return folder


def methods_of(*evaluations: EvaluationRun) -> list[EvaluatedPolicy]:
    """The methods of evaluations, as figures get them."""
    return [method for one in collect_comparisons(evaluations) for method in one.methods]
