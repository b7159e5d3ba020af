"""Actions that are held for several control steps."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulations import environment_conf
from training import assert_halves_make_a_whole, small

import dune_rl
from dune_rl.config.build import make_learning_env, make_simulation
from dune_rl.env.replay import state_digest
from dune_rl.env.simulation import VectorSimulation


def simulation(repeat: int, scenes: int = 2, **settings: Any) -> VectorSimulation:
    conf = environment_conf("flat", physics={"action_repeat": repeat}, **settings)
    made = make_simulation(conf, scenes, 3)
    made.reset()
    return made


def test_rewards_are_summed_and_states_are_those_of_single_steps() -> None:
    held, single = simulation(4), simulation(1)
    actions = {"rover": np.tile([0.8, 0.4], (2, 1, 1))}
    for _ in range(3):
        result = held.advance(actions)
        rewards = [single.advance(actions).groups["rover"].reward for _ in range(4)]
        np.testing.assert_allclose(result.groups["rover"].reward, np.sum(rewards, axis=0), rtol=1e-5)
        assert state_digest(held.state) == state_digest(single.state)
    assert held.steps.tolist() == [12, 12]


def test_a_scene_that_ends_rests_until_it_is_reset() -> None:
    made = simulation(4, task={"terminations": {"time_limit": {"max_steps": 6}}})
    actions = {"rover": np.tile([0.8, 0.0], (2, 1, 1))}
    for _ in range(3):
        made.step(actions)
    made.reset(np.array([True, False]))
    # Scene 1 has three steps left.
    result = made.advance(actions)
    assert result.truncated.tolist() == [False, True] and made.resting.tolist() == [False, True]
    metrics, steps = made.metrics()[:, 0], made.metric_names().index("steps")
    assert metrics[:, steps].tolist() == [4.0, 6.0]
    made.reset(np.array([False, True]))
    result = made.advance(actions)
    assert result.truncated.tolist() == [True, False] and made.resting.tolist() == [True, False]


@pytest.mark.parametrize("make", [dune_rl.parallel_env, dune_rl.gym_env])
def test_clients_hold_actions(make: Any) -> None:
    env = make("flat", 0, actors="none", physics={"action_repeat": 5})
    assert env.metadata["render_fps"] == 4
    env.reset(seed=0)
    inside = env.unwrapped if hasattr(env, "unwrapped") else env
    action = np.array([0.5, 0.0], np.float32)
    env.step({"rover_0": action} if make is dune_rl.parallel_env else action)
    assert inside.simulation.steps.tolist() == [5]
    env.close()


@pytest.mark.slow
def test_a_resumed_training_repeats_held_actions(tmp_path: Path) -> None:
    conf = environment_conf(
        "flat", physics={"action_repeat": 4}, task={"terminations": {"time_limit": {"max_steps": 30}}}
    )
    learning = small(hidden=(16,), batch_size=16, learning_starts=64)
    assert_halves_make_a_whole(partial(make_learning_env, conf), tmp_path, learning, frames=640, half=300)
