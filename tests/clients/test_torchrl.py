"""TorchRL's wrappers, checks and processes on environments of ours, and its own environment."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from torchrl.envs import (
    Compose,
    GymEnv,
    GymWrapper,
    ParallelEnv,
    PettingZooWrapper,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    check_env_specs,
)
from torchrl.record import PixelRenderTransform

import dune_rl
from dune_rl.env.torchrl import EpisodeMetrics, SingleAgent

ID = "dune_rl:dune_rl/Flat-v0"
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 5}}}}


@pytest.mark.slow
@pytest.mark.client("TorchRL", "`GymEnv`: `check_env_specs`, `from_pixels`, `SerialEnv`", "gymnasium.make")
def test_its_wrapper_of_gymnasium() -> None:
    for flatten in (False, True):
        env = GymEnv(ID, flatten=flatten, **SHORT)
        check_env_specs(env)
        env.close()
    pixels = GymEnv(ID, from_pixels=True, pixels_only=False)
    assert pixels.rollout(2)["pixels"].shape == (2, 480, 640, 3)
    pixels.close()
    serial = SerialEnv(2, partial(GymEnv, ID, **SHORT))
    serial.set_seed(3)
    first, again = serial.reset(), serial.set_seed(3) and serial.reset()
    assert (first["goal"] == again["goal"]).all() and (first["goal"][0] != first["goal"][1]).any()
    serial.close()


@pytest.mark.client("TorchRL", "`GymWrapper` of the batch, which TorchRL resets", "gymnasium.make_vec")
@pytest.mark.parametrize("flatten", [False, True])
def test_its_wrapper_of_vector_environments(flatten: bool) -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, autoreset_mode="disabled", flatten=flatten, **SHORT)
    env = GymWrapper(envs)
    check_env_specs(env)
    data = env.rollout(12, break_when_any_done=False)
    assert data["next", "truncated"].sum() == 4
    env.close()


@pytest.mark.client("TorchRL", "`PettingZooWrapper`: `check_env_specs`", "dune_rl.parallel_env")
@pytest.mark.parametrize("flatten", [False, True])
@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")
def test_its_wrapper_of_pettingzoo(actors: str, flatten: bool) -> None:
    env = PettingZooWrapper(dune_rl.parallel_env("flat", 0, actors=actors, flatten=flatten, **SHORT))
    check_env_specs(env)
    assert set(env.group_map) == ({"rover", "walker"} if actors == "external_walkers" else {"rover"})
    env.close()


@pytest.mark.client("TorchRL", "its own environment: `check_env_specs`, transforms", "dune_rl.make")
@pytest.mark.parametrize("flatten", [False, True])
def test_the_environment(flatten: bool) -> None:
    env = dune_rl.make("flat", 2, actors="external_walkers", flatten=flatten, **SHORT)
    check_env_specs(env)
    env.close()
    transforms = Compose(EpisodeMetrics(), SingleAgent(), StepCounter(), RewardSum())
    one = TransformedEnv(dune_rl.make("flat", 2, flatten=flatten, **SHORT), transforms)
    check_env_specs(one)
    data = one.rollout(5)
    assert {"observation", "lidar"} & {*data.keys()} == ({"observation"} if flatten else {"lidar"})
    assert (data["next", "step_count"][:, -1] == 5).all()
    one.close()


def test_flat_observations_are_those_of_pettingzoo() -> None:
    env = dune_rl.make("flat", 1, 3, actors="external_walkers", flatten=True)
    other = dune_rl.parallel_env("flat", 3, actors="external_walkers", flatten=True)
    data, (seen, _) = env.reset(), other.reset()
    for group, agents in env.group_map.items():
        values = data[group, "observation"][0].numpy()
        np.testing.assert_allclose(values, [seen[agent] for agent in agents], atol=1e-6)
        assert env.observation_spec[group, "observation"].contains(data[group, "observation"])
    env.close()
    other.close()


@pytest.mark.slow
@pytest.mark.client("TorchRL", "`ParallelEnv`, its processes forked or spawned", "dune_rl.make")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes(method: str) -> None:
    env = ParallelEnv(2, partial(dune_rl.make, "flat", 2, flatten=True, **SHORT), mp_start_method=method)
    data = env.rollout(12, break_when_any_done=False)
    assert data.batch_size == (2, 2, 12) and data["next", "done"].sum() == 8
    env.close()


@pytest.mark.slow
@pytest.mark.client("TorchRL", "`PixelRenderTransform`", "dune_rl.make")
def test_it_records_pixels() -> None:
    env = TransformedEnv(dune_rl.make("flat", 2), PixelRenderTransform())
    pictures = env.rollout(2)["pixels"]
    assert np.asarray(pictures[0][0]).shape == (480, 640, 3)
    env.close()
