"""An episode has the same numbers as a transform, in training's logs, in evaluations and in infos."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchrl.envs import Compose, TransformedEnv

import dune_rl
from dune_rl import evaluate
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.learning.run.log import RunLog
from dune_rl.metrics.registry import METRICS
from dune_rl.state import Array, GroupState, State
from dune_rl.statistics.measures import average_metrics

SEED, EPISODES = 5, 4
DRIVER = """
import numpy as np


def drive(observation):
    bearing = np.clip(observation["goal"][:, 1], -3.0, 3.0)
    return np.stack([0.9 * np.ones_like(bearing), bearing], axis=1)
"""
SETTINGS = [
    "metrics=navigation",
    "metrics.terms.my_height.reduce=max",
    "task.terminations.time_limit.max_steps=110",
    "task.terminations.goal_reached.distance_m=3.0",
]
# Of every kind: stateful, shared by several metrics, NaN where there is none, a user's own.
NAMES = ("success", "time_to_goal", "clearance", "spl", "path_length", "jerk", "near_misses", "my_height")


def my_height(state: State, group: GroupState) -> Array:
    """Height of the robot's origin [m]."""
    return group.motion.position_w[:, 2].copy()


@pytest.fixture(autouse=True)
def _own_metric() -> Any:
    dune_rl.register_metric(my_height)
    yield
    del METRICS._user_parts["my_height"]


def drive(observation: Any) -> np.ndarray:
    """The same driver, of the readings (N, ...) of the goal."""
    bearing = np.clip(observation[:, 1], -3.0, 3.0)
    return np.stack([0.9 * np.ones_like(bearing), bearing], axis=1).astype(np.float32)


def of_a_rollout(folder: Path) -> tuple[list[dict[str, float]], list[dict[str, float]], Path]:
    """Rows by keys of their own, rows by the settings' array, and the folder of a log of the same batch."""
    env = dune_rl.make("inspection", 2, SEED, overrides=SETTINGS)
    conf = env.simulation.group().setup.metrics
    assert conf is not None
    chosen = {name: conf.terms[name].model_dump() for name in NAMES}
    env = TransformedEnv(env, Compose(EpisodeMetrics(chosen), EpisodeMetrics()))
    columns = env.transform[1].metric_names["rover"]
    now, steps = env.reset(), []
    while not steps or sum(int(step["next", "done"].sum()) for step in steps) < EPISODES + 2:
        now["rover", "action"] = torch.from_numpy(drive(now["rover", "observation", "goal"][:, 0].numpy()))[
            :, None
        ]
        step, now = env.step_and_maybe_reset(now)
        steps.append(step)
    batch = torch.stack(steps, dim=1)
    env.close()
    done = batch["next", "done"].squeeze(-1)
    ended = batch["next"][done]["rover"]
    array = [dict(zip(columns, row, strict=True)) for row in ended["metrics"][:, 0].tolist()]
    keys = [
        {name: float(ended[f"episode_{name}"][row].squeeze()) for name in NAMES} for row in range(len(array))
    ]
    order = sorted(range(len(array)), key=lambda row: array[row]["episode"])[:EPISODES]
    log = RunLog(folder / "log", {"rover": columns})
    log.log_evaluation({"rover": [array[row] for row in order]}, 10, {"rover": 1})
    log.log_batch(batch, 20, {"rover": 1})
    log.close()
    return [keys[row] for row in order], array, folder / "log"


def same(values: Any, others: Any) -> bool:
    return bool(np.allclose(np.array(values, float), np.array(others, float), rtol=1e-6, equal_nan=True))


@pytest.mark.slow
def test_equal_numbers_everywhere(
    call: Callable[..., int], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "my_driver.py").write_text(DRIVER)
    monkeypatch.syspath_prepend(folder)
    words = ["policy=my_driver:drive", f"episodes={EPISODES}", f"seed={SEED}", "scenes=3", "out=results"]
    assert call(evaluate.main, "+world=inspection", *SETTINGS, *words) == 0
    with (folder / "results" / "episodes.csv").open() as file:
        table = list(csv.DictReader(file))
    evaluated = [{name: float(row[name] or "nan") for name in NAMES} for row in table]

    keys, array, log = of_a_rollout(folder)
    assert any(row["success"] for row in keys) and not all(row["success"] for row in keys)
    for name in NAMES:
        assert same([row[name] for row in keys], [row[name] for row in evaluated]), name
    by_episode = sorted(array, key=lambda row: row["episode"])[:EPISODES]
    assert same([[row[name] for name in NAMES] for row in by_episode], [[*row.values()] for row in keys])

    # metrics.csv and TensorBoard have the means of the same rows, a user's metric too.
    with (log / "metrics.csv").open() as file:
        (logged,) = csv.DictReader(file)
    events = EventAccumulator(str(log))
    events.Reload()
    measures = {
        "SR": "success",
        "MTT": "time_to_goal",
        "OC": "clearance",
        "SPL": "spl",
        "my_height": "my_height",
    }
    for measure, name in measures.items():
        mean = float(np.nanmean([row[name] for row in evaluated]))
        assert same(float(logged[measure]), mean)
        assert same(events.Scalars(f"eval/{measure}")[0].value, mean)
        assert same(events.Scalars(f"train/{measure}")[0].value, average_metrics(array)[measure])

    for rows in (of_pettingzoo(), of_gymnasium()):
        for name in NAMES:
            known = [-1.0 if math.isnan(row[name]) else row[name] for row in evaluated]
            assert same([row[name] for row in rows], known), name


def of_pettingzoo() -> list[dict[str, float]]:
    """Final infos of the first episodes."""
    env = dune_rl.parallel_env("inspection", SEED, overrides=SETTINGS)
    rows = []
    for _ in range(EPISODES):
        seen, infos = env.reset()
        while env.agents:
            action = drive(seen["rover_0"]["goal"][None])[0]
            seen, _, _, _, infos = env.step({"rover_0": action})
        rows.append(infos["rover_0"])
    env.close()
    return rows


def of_gymnasium() -> list[dict[str, float]]:
    env = dune_rl.gym_env("inspection", SEED, overrides=SETTINGS)
    assert isinstance(env, gymnasium.Env)
    rows = []
    for _ in range(EPISODES):
        seen, info = env.reset()
        ended = False
        while not ended:
            seen, _, terminated, truncated, info = env.step(drive(seen["goal"][None])[0])
            ended = terminated or truncated
        rows.append(info)
    env.close()
    return rows
