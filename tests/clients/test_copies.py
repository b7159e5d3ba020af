"""Pickles and copies of environments: independent, and at the same point."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest

import dune_rl
from dune_rl.env.pettingzoo import ParallelDuneEnv

MAKERS = {
    "pettingzoo": lambda: dune_rl.parallel_env("flat", 3),
    "gymnasium": lambda: gymnasium.make("dune_rl:dune_rl/Flat-v0", seed=3).unwrapped,
    "vector": lambda: dune_rl.gym_vector_env("flat", 2, 3),
}
every_client = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)


def actions(env, number: int):
    rng = np.random.default_rng(number)
    if isinstance(env, ParallelDuneEnv):
        return {agent: rng.uniform(-1.0, 1.0, 2).astype(np.float32) for agent in env.possible_agents}
    return rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)


def drive(env, first: int, count: int) -> list[bytes]:
    return [pickle.dumps(env.step(actions(env, number))) for number in range(first, first + count)]


@pytest.mark.slow(all_but=["gymnasium"])
@every_client
def test_a_copy_goes_on_as_its_original_would(make) -> None:
    env = make()
    env.reset(seed=5)
    drive(env, 0, 12)
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    expected = drive(env, 12, 5)
    for other in copies:
        assert other.simulation is not env.simulation
        assert drive(other, 12, 5) == expected
        # A copy of a copy, and closing one leaves the others.
        again = copy.deepcopy(other)
        other.close()
        assert len(drive(again, 20, 2)) == 2
        again.close()
    assert len(drive(env, 17, 2)) == 2
    env.close()


@every_client
def test_a_copy_before_the_first_episode_and_after_the_end(make) -> None:
    env = make()
    other = copy.deepcopy(env)
    assert pickle.dumps(env.reset(seed=2)) == pickle.dumps(other.reset(seed=2))
    env.close()
    closed = copy.deepcopy(env)
    with pytest.raises(RuntimeError, match="closed"):
        closed.reset()
    other.close()


def test_a_copy_knows_the_places_that_were_asked_for() -> None:
    env = dune_rl.parallel_env("flat", 0)
    env.reset(options={"start": (1.0, 2.0, 0.5), "goal": (4.0, 2.0)})
    drive(env, 0, 3)
    other = copy.deepcopy(env)
    assert drive(other, 3, 3) == drive(env, 3, 3)
    env.close()
    other.close()


@pytest.mark.parametrize("flatten", [False, True])
def test_a_torchrl_environment_is_copied_too(flatten: bool) -> None:
    import torch

    env = dune_rl.make("flat", 2, 3, flatten=flatten)
    key = ("observation",) if flatten else ("observation", "goal")
    first = env.reset()
    step = env.rand_step(first)
    other = copy.deepcopy(env)
    assert other.simulation is not env.simulation
    action = step.clone()
    torch.testing.assert_close(
        other.step(action.clone())["next", "rover", *key],
        env.step(action.clone())["next", "rover", *key],
    )
    env.close()
    other.close()


def test_gymnasium_s_own_state_is_copied() -> None:
    for env in (
        gymnasium.make("dune_rl:dune_rl/Flat-v0"),
        gymnasium.make_vec("dune_rl:dune_rl/Flat-v0", num_envs=2),
    ):
        env.reset(seed=3)
        env.action_space.seed(5)
        other = copy.deepcopy(env)
        assert other.unwrapped.spec == env.unwrapped.spec is not None
        assert env.unwrapped.np_random_seed == other.unwrapped.np_random_seed == 3
        assert env.unwrapped.np_random.random() == other.unwrapped.np_random.random()
        space, copied = env.unwrapped.action_space, other.unwrapped.action_space
        for _ in range(3):
            np.testing.assert_array_equal(space.sample(), copied.sample())
        env.close()
        other.close()


def test_a_copy_s_samples_are_those_of_its_original() -> None:
    env = dune_rl.parallel_env("flat", 0)
    env.reset(seed=3)
    env.action_space("rover_0").seed(5)
    other = copy.deepcopy(env)
    first, second = (each.action_space("rover_0") for each in (env, other))
    assert first is not second
    for _ in range(3):
        np.testing.assert_array_equal(first.sample(), second.sample())
    env.close()
    other.close()


def test_what_was_made_of_a_simulation_refuses() -> None:
    env = dune_rl.parallel_env("flat", 0)
    own = ParallelDuneEnv(env.simulation)
    for refused in (pickle.dumps, copy.deepcopy):
        with pytest.raises(TypeError, match=r"made of a simulation.*dune_rl\.parallel_env"):
            refused(own)
    env.close()
