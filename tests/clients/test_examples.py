"""The files of `examples/`, run for a moment."""

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.client("Stable-Baselines3", "a `VecEnv` over the batch (`examples/`)", "dune_rl.gym_vector_env")
def test_stable_baselines3_on_a_batch() -> None:
    example = runpy.run_path(str(EXAMPLES / "stable_baselines3_batch.py"))
    model = example["main"](["--scenes", "3", "--frames", "96", "--rollout", "16"])
    assert model.num_timesteps == 96


@pytest.mark.client("Stable-Baselines3", "a `VecEnv` over the batch (`examples/`)", "dune_rl.gym_vector_env")
def test_its_environment_ends_episodes_as_stable_baselines3_expects() -> None:
    example = runpy.run_path(str(EXAMPLES / "stable_baselines3_batch.py"))
    task = {"name": "paper", "terminations": {"time_limit": {"max_steps": 4}}}
    envs = example["DuneVecEnv"]("flat", 2, task=task)
    envs.seed(3)
    first = envs.reset()
    for _ in range(4):
        seen, rewards, dones, infos = envs.step(np.zeros((2, 2), np.float32))
    assert dones.all() and rewards.shape == (2,)
    for scene, info in enumerate(infos):
        assert info["TimeLimit.truncated"] and info["steps"] == 4.0
        last = info["terminal_observation"]
        assert any((last[key] != seen[key][scene]).any() for key in last)
    envs.seed(3)
    again = envs.reset()
    assert all(np.array_equal(first[key], again[key]) for key in first)
    envs.close()
