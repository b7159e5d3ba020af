"""Evaluation on numbered episodes, the same for every policy."""

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from torchrl.envs import EnvBase

from dune_rl.errors import CheckpointError
from dune_rl.files import write_atomically
from dune_rl.learning.policies import Policy
from dune_rl.learning.random_state import undisturbed
from dune_rl.learning.statistics import Estimate, PairedTest, mcnemar, mean, proportion
from dune_rl.settings import Settings

Row = dict[str, float]


class EvaluationConf(Settings):
    """When training pauses to measure its policy, and on how much."""

    every_frames: int = Field(250_000, ge=1)
    episodes: int = Field(50, ge=1)
    scenes: int = Field(16, ge=1, description="episodes run side by side; no result depends on it")
    seed_offset: int = Field(1_000_003, ge=1, description="added to the run's seed; training never sees it")


@torch.no_grad()
def evaluate(
    policy: Policy,
    env: EnvBase,
    episodes: int,
    seed: int,
    *,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:
    """The metrics of episodes 0 to `episodes` - 1 of `seed`, in that order, each run exactly once.

    `env` is a batch of scenes, seeded anew here; how many there are changes
    no row. The process's random states are left as they were. When `stop`
    says so, the rows finished by then are returned. `progress` is told how
    many are done.
    """
    found: dict[int, Row] = {}
    names = env.metric_names
    with undisturbed():
        env.set_seed(seed)
        observation = env.reset()
        while len(found) < episodes and not stop():
            after, observation = env.step_and_maybe_reset(policy(observation))
            finished = after["next", "done"].squeeze(-1)
            if not finished.any():
                continue
            for values in after["next", "metrics"][finished].tolist():
                row = dict(zip(names, values, strict=True))
                # A scene goes on with later ids while others are still at theirs.
                if row["episode"] < episodes:
                    found[int(row["episode"])] = row
            progress(len(found))
    return [found[episode] for episode in sorted(found)]


# The paper's short names and what the battery gives, with meaning and unit.
MEASURES: dict[str, tuple[str, str]] = {
    "SR": ("goal reached without collision", ""),
    "TR": ("goal reached", ""),
    "TC": ("collisions per episode", ""),
    "MTT": ("mean time to traverse", "s"),
    "OC": ("obstacle clearance", "m"),
    "VR": ("vertical roughness", "m/s²"),
    "VORT": ("velocity over rough terrain", "m/s"),
    "TSR": ("smoothness of route, less is smoother", ""),
    "energy": ("drawn from the battery", "W h"),
    "battery": ("share of a full one", ""),
    "range": ("with a full battery", "km"),
}
_COLUMNS = {
    "SR": "success",
    "TR": "reached",
    "TC": "collisions",
    "MTT": "time_to_goal",
    "OC": "clearance",
    "VR": "vertical_roughness",
    "VORT": "vort",
    "TSR": "smoothness",
}
# With `metrics.energy`.
_ENERGY_COLUMNS = {"energy": "energy_wh", "battery": "battery_share", "range": "range_km"}


def averages(rows: Sequence[Mapping[str, float]]) -> Row:
    """Means over the episodes `rows`: the paper's `MEASURES`, return, steps; NaN where none was measured."""
    columns = {**_COLUMNS, "return": "return", "steps": "steps"}
    if not rows:
        return dict.fromkeys(columns, float("nan"))
    values = {name: np.array([row[column] for row in rows]) for name, column in columns.items()}
    return {
        name: float(column[~np.isnan(column)].mean()) if not np.isnan(column).all() else float("nan")
        for name, column in values.items()
    }


def summary(rows: Sequence[Mapping[str, float]]) -> dict[str, Estimate]:
    """Each of `MEASURES` that was measured with its 95 % interval.

    SR and TR are shares of episodes; the rest are means over the episodes
    that have a value: MTT over those that reached the goal, VORT over those
    that met an uneven section.
    """
    return {
        name: (proportion if name in ("SR", "TR") else mean)([row[column] for row in rows])
        for name, column in (_COLUMNS | _ENERGY_COLUMNS).items()
        if name in _COLUMNS or (rows and column in rows[0])
    }


def compare(rows_a: Sequence[Mapping[str, float]], rows_b: Sequence[Mapping[str, float]]) -> PairedTest:
    """Exact paired test of success between two evaluations; raises ValueError unless their episodes agree."""
    ids_a, ids_b = ([row["episode"] for row in rows] for rows in (rows_a, rows_b))
    if ids_a != ids_b:
        raise ValueError("the two evaluations ran different episodes, so they do not pair")
    return mcnemar([row["success"] > 0 for row in rows_a], [row["success"] > 0 for row in rows_b])


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write `rows` atomically, one line each, with the columns of the first; raises CheckpointError."""
    try:
        with write_atomically(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else [])
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be written: {error.strerror or error}.\nGive a folder that allows writing."
        ) from error
