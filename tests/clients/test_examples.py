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


@pytest.mark.slow(all_but=["ippo"])
@pytest.mark.client("TorchRL", "its own loop of MAPPO and IPPO on walkers (`examples/`)", "dune_rl.make")
@pytest.mark.parametrize("words", [[], ["--own-critic"]], ids=["mappo", "ippo"])
def test_torchrl_s_own_loop_on_walkers(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(EXAMPLES / "torchrl_mappo_walkers.py"))
    small = ["--scenes", "2", "--rollout", "8", "--frames", "32", "--max-steps", "8", "--cells", "8"]
    result = example["main"]([*small, "--epochs", "2", *words])
    assert len(result.collected) == 2 and np.isfinite([*result.collected, result.evaluated]).all()
    assert result.collected[0] != result.collected[1]
    assert "return in new episodes" in capsys.readouterr().out


def test_walkers_learn_from_each_other_s_steps() -> None:
    example = runpy.run_path(str(EXAMPLES / "torchrl_mappo_walkers.py"))
    env = example["make_env"]("flat", 2, 0, 6)
    policy = example["make_policy"](env, 8)
    central, own = (example["make_critic"](env, 8, central=central) for central in (True, False))
    data = env.rollout(6, policy)
    spec = env.full_action_spec_unbatched["walker", "action"]
    assert (data["walker", "action"] >= spec.space.low).all()
    assert (data["walker", "action"] <= spec.space.high).all()
    # The central critic's value of a walker depends on what the other one sees.
    changed = data.clone()
    changed["walker", "observation"][..., 1, :] += 0.3
    for critic, depends in ((central, True), (own, False)):
        before = critic(data.clone())["walker", "state_value"][..., 0, :]
        after = critic(changed.clone())["walker", "state_value"][..., 0, :]
        assert bool((before != after).any()) == depends
    env.close()
