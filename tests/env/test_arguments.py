"""What users give to environments: every fault is named, with what to do about it."""

from typing import Any

import numpy as np
import pytest

import dune_rl
from dune_rl.env.pettingzoo import ParallelDuneEnv
from dune_rl.env.replay import RestoreError

STILL = np.zeros(2, np.float32)


@pytest.fixture(scope="module")
def env() -> ParallelDuneEnv:
    return dune_rl.parallel_env("flat", agents={"rover": {"body": "rover_zero", "count": 2}})


@pytest.mark.parametrize(
    "wrong", [None, "ahead", 1.0, np.zeros(3), {"speed": 1.0}, [np.nan, 0.0], [np.inf, 0.0]]
)
def test_an_action_that_is_none_is_named(env: ParallelDuneEnv, wrong: Any) -> None:
    env.reset(seed=1)
    with pytest.raises(ValueError, match="the action of rover_1 must be 2 finite numbers"):
        env.step({"rover_0": STILL, "rover_1": wrong})
    with pytest.raises(ValueError, match="every agent, and rover_1 has none; there are rover_0"):
        env.step({"rover_0": STILL})
    with pytest.raises(ValueError, match="every agent, and rover_0 has none; the mapping is empty"):
        env.step({})
    with pytest.raises(ValueError, match="a mapping from agents to actions"):
        env.step([STILL, STILL])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "said"), [(np.zeros((1, 2, 3)), "shape"), (np.full((1, 2, 2), np.nan), "finite")]
)
def test_actions_of_a_group_are_checked(env: ParallelDuneEnv, values: Any, said: str) -> None:
    env.reset(seed=1)
    with pytest.raises(ValueError, match=f"actions of the group 'rover' must .*{said}"):
        env.simulation.step({"rover": values})


def test_step_comes_after_reset_and_before_close() -> None:
    env = dune_rl.parallel_env("flat", actors="none")
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step"):
        env.step({"rover_0": STILL})
    with pytest.raises(dune_rl.ConfigError, match="seed must be a whole number of at least 0"):
        env.reset(seed=-1)
    env.reset(seed=1)
    env.close()
    for call in (env.reset, lambda: env.step({"rover_0": STILL})):
        with pytest.raises(RuntimeError, match="is closed: make another"):
            call()


@pytest.mark.parametrize("wrong", [0, 1.5, "2", True])
def test_num_scenes_is_checked(wrong: Any) -> None:
    with pytest.raises(dune_rl.ConfigError, match="num_scenes must be a whole number of at least 1"):
        dune_rl.make("flat", num_scenes=wrong)


@pytest.mark.parametrize("wrong", [-1, "one", None])
def test_the_seed_is_checked(wrong: Any) -> None:
    with pytest.raises(dune_rl.ConfigError, match="seed must be a whole number of at least 0"):
        dune_rl.parallel_env("flat", seed=wrong)


def test_other_agents_than_those_saved_are_a_restore_error() -> None:
    one = dune_rl.parallel_env("flat", actors="none")
    one.reset(seed=1)
    one.step({"rover_0": STILL})
    saved = one.simulation.save_state()
    two = dune_rl.parallel_env("flat", agents={"rover": {"body": "rover_zero", "count": 2}})
    with pytest.raises(RestoreError, match="other agents"):
        two.simulation.restore(saved)


def test_close_frees_the_simulation_of_torchrls_environment() -> None:
    env = dune_rl.make("flat", num_scenes=1, actors="none")
    env.reset()
    assert not env.is_closed
    env.close()
    env.close()
    assert env.is_closed
    with pytest.raises(RuntimeError, match="is closed: make another"):
        env.reset()
