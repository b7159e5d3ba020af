"""Steps of the TorchRL environment, for its tests."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

import dune_rl
from dune_rl.env.torchrl import EpisodeMetrics

# Goals lie 2 m away and more: some episodes end by arrival, many at once, and the others by time.
SHORT = {"terminations": {"time_limit": {"max_steps": 9}, "goal_reached": {"distance_m": 3.0}}}


def make(*args: Any, **settings: Any) -> EnvBase:
    """`dune_rl.make`, with metrics."""
    return TransformedEnv(dune_rl.make(*args, **settings), EpisodeMetrics())


def acted(env: EnvBase, data: TensorDictBase, generator: torch.Generator) -> TensorDictBase:
    """`data` with random actions, which depend on `generator` alone."""
    spec = env.full_action_spec
    for key in spec.keys(True, True):
        low, high = spec[key].space.low, spec[key].space.high
        data.set(key, low + (high - low) * torch.rand(low.shape, generator=generator))
    return data


def advance(
    env: EnvBase, data: TensorDictBase, steps: int, seed: int
) -> tuple[TensorDictBase, TensorDictBase]:
    """The steps (time first) of a random rollout with resets, and the data that the next step starts from."""
    generator = torch.Generator().manual_seed(seed)
    out = []
    for _ in range(steps):
        now, data = env.step_and_maybe_reset(acted(env, data, generator))
        out.append(now.clone())
    return torch.stack(out), data


def metric(env: EnvBase, data: TensorDictBase, name: str, group: str = "rover") -> torch.Tensor:
    """A metric of the first agent of each scene."""
    return data[group, "metrics"][..., 0, env.metric_names[group].index(name)]


def observed(data: TensorDictBase, name: str) -> torch.Tensor:
    """What the rover of each scene observes."""
    return data["rover", "observation", name][..., 0, :]
