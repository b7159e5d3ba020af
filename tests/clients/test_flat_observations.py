"""Observations as one vector, for clients without dicts."""

import gymnasium
import numpy as np
import pytest

import dune_rl
from dune_rl.env.pettingzoo import ParallelDuneEnv

SENSORS = {"enabled": ["camera", "lidar", "goal"], "camera": {"height": 4, "width": 6}}


def flat_and_dict(make):
    return make(flatten=True), make(flatten=False)


def joined(observation: dict[str, np.ndarray], lead: int = 0) -> np.ndarray:
    parts = [observation[key].reshape(*observation[key].shape[:lead], -1) for key in sorted(observation)]
    return np.concatenate(parts, axis=-1).astype(np.float32)


@pytest.mark.slow(all_but=["robots1"])
@pytest.mark.parametrize("robots", [["rover_zero"], ["rover_zero", "rover_zero"]])
def test_pettingzoo(robots) -> None:
    flat, plain = flat_and_dict(
        lambda flatten: dune_rl.parallel_env("flat", 1, flatten=flatten, robots=robots, sensors=SENSORS)
    )
    seen, _ = flat.reset()
    expected, _ = plain.reset()
    for _ in range(3):
        for agent, vector in seen.items():
            np.testing.assert_array_equal(vector, joined(expected[agent]))
            assert flat.observation_space(agent).contains(vector)
        actions = {agent: flat.action_space(agent).sample() for agent in flat.agents}
        seen, *_ = flat.step(actions)
        expected, *_ = plain.step(actions)
    flat.close()
    plain.close()


def test_gymnasium_and_its_vector_environment() -> None:
    one = gymnasium.make("dune_rl:dune_rl/Flat-v0", flatten=True, seed=2)
    vector, _ = one.reset(seed=2)
    assert one.observation_space.contains(vector)
    envs, plain = flat_and_dict(lambda flatten: dune_rl.gym_vector_env("flat", 2, 2, flatten=flatten))
    seen, _ = envs.reset(seed=2)
    expected, _ = plain.reset(seed=2)
    np.testing.assert_array_equal(seen, joined(expected, 1))
    np.testing.assert_allclose(seen[0], vector, atol=1e-6)
    assert envs.observation_space.contains(seen)
    for env in (one, envs, plain):
        env.close()


def test_the_order_is_gymnasium_s() -> None:
    flat, plain = flat_and_dict(lambda flatten: dune_rl.gym_env("flat", 2, flatten=flatten))
    (seen, _), (expected, _) = flat.reset(seed=2), plain.reset(seed=2)
    np.testing.assert_array_equal(seen, gymnasium.spaces.flatten(plain.observation_space, expected))
    flattened = gymnasium.spaces.flatten_space(plain.observation_space)
    np.testing.assert_array_equal(flat.observation_space.low, flattened.low)
    flat.close()
    plain.close()


def test_agents_have_spaces_of_their_own() -> None:
    env = dune_rl.parallel_env("flat", 1, robots=["rover_zero", "rover_zero"])
    assert isinstance(env, ParallelDuneEnv)
    one, two = (env.observation_space(agent) for agent in env.possible_agents)
    assert one == two and one is not two
    env.close()
