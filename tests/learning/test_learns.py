"""Soft actor-critic learns: the median of three seeds, so that no single run decides, in float32."""

import statistics
from pathlib import Path

import pytest
from point_mass import make_point_mass, make_team, make_two_groups
from training import SMALL, small, trainer

from dune_rl.learning.collector import MakeEnv

# With these settings six of six seeds reached all goals after 2,048 frames.
QUICK = small(
    hidden=(64, 64),
    batch_size=256,
    updates_per_frame=1 / 8,
    gamma=0.9,
    n_steps=4,
    learning_rate=5e-3,
    tau=0.02,
    evaluation=SMALL.evaluation.model_copy(update={"every_frames": 10**6, "episodes": 20, "scenes": 20}),
)


def success_rates(folder: Path, make_env: MakeEnv, frames: int) -> list[dict[str, float]]:
    """Of each group after `frames`, for each of three seeds."""
    rates = []
    for seed in (1, 2, 3):
        run = trainer(folder / str(seed), QUICK, make_env=make_env, total_frames=frames, seed=seed)
        evaluation = run.train().evaluation
        rates.append(
            {group: statistics.fmean(row["success"] for row in rows) for group, rows in evaluation.items()}
        )
    return rates


@pytest.mark.slow
def test_learns_to_reach_the_goal(tmp_path: Path) -> None:
    rates = success_rates(tmp_path, make_point_mass, 2048)
    assert statistics.median(rate["rover"] for rate in rates) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("make_env", [make_team, make_two_groups])
def test_teams_and_several_groups_learn(tmp_path: Path, make_env: MakeEnv) -> None:
    rates = success_rates(tmp_path, make_env, 4096)
    for group in rates[0]:
        assert statistics.median(rate[group] for rate in rates) > 0.8
