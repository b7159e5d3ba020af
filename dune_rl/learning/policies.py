"""Policies to evaluate: built-in references, and trained ones from their files."""

from pathlib import Path
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dune_rl.errors import ConfigError
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, find, read
from dune_rl.learning.layout import Layout
from dune_rl.learning.networks import Architecture, make_policy

_SPEED_AND_HEADING = 2
_GUIDE_NOISE = 0.1
_GUIDE_RANDOM_SHARE = 0.3


class Policy(Protocol):
    """Writes "action" (M, A) into what a batch of M scenes observes."""

    def __call__(self, observation: TensorDictBase) -> TensorDictBase: ...


class GoToGoal:
    """Turns towards the goal, then drives at it, whatever lies between."""

    def __init__(self, layout: Layout) -> None:
        if len(layout.high) != _SPEED_AND_HEADING:
            raise ConfigError(
                f"go_to_goal tells a speed and a heading, and this robot takes {len(layout.high)} numbers; "
                f"take policy=random, in training learning.warm_up=random, or robot.action=speed_and_heading"
            )
        self._top_speed = layout.high[0]

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        """Commands the goal's heading, and the speed's share that points at the goal."""
        heading = observation.get("goal")[..., 1]
        speed = self._top_speed * heading.cos().clamp(min=0)
        return observation.set("action", torch.stack([speed, heading], -1))


class Guide(TensorDictModuleBase):
    """Drives at the goal with noise, and at random in a share of steps: experience to begin with.

    Random actions alone reach one goal in ten episodes of 2,000 steps, and a
    learner that has hardly met a goal learns to keep away from everything.
    """

    in_keys = ["goal"]  # noqa: RUF012
    out_keys = ["action"]  # noqa: RUF012

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        if "goal" not in layout.sizes:
            raise ConfigError("learning.warm_up=go_to_goal needs the sensor goal; take warm_up=random")
        self._drive = GoToGoal(layout)
        self.register_buffer("_low", torch.tensor(layout.low))
        self.register_buffer("_high", torch.tensor(layout.high))

    @torch.no_grad()
    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes "action" (M, A), drawn with torch's global generator."""
        action = self._drive(observation).get("action")
        width = self._high - self._low
        noisy = action + _GUIDE_NOISE * width * torch.randn_like(action)
        random = self._low + width * torch.rand_like(action)
        astray = torch.rand_like(action[..., :1]) < _GUIDE_RANDOM_SHARE
        return observation.set("action", torch.where(astray, random, noisy).clamp(self._low, self._high))


class UniformRandom:
    """Draws every action uniformly within its bounds, from a stream of its own."""

    def __init__(self, layout: Layout, seed: int = 0) -> None:
        self._low = torch.tensor(layout.low)
        self._width = torch.tensor(layout.high) - self._low
        self._generator = torch.Generator().manual_seed(seed)

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        """Ignores what is observed but for its batch size."""
        share = torch.rand((*observation.batch_size, len(self._low)), generator=self._generator)
        return observation.set("action", self._low + share * self._width)


class Deterministic:
    """A trained policy's most likely behaviour: the squashed location of its distribution."""

    def __init__(self, module: torch.nn.Module) -> None:
        self._module = module

    @torch.no_grad()
    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        """Acts without noise and without changing the module's statistics."""
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return self._module(observation)


def policy_content(
    module: torch.nn.Module, layout: Layout, architecture: Architecture, config: dict[str, Any]
) -> dict[str, Any]:
    """What a policy's file holds: weights, statistics, layout, and the settings that made it."""
    weights = {key: value.detach().cpu().clone() for key, value in module.state_dict().items()}
    return {
        "policy": weights,
        "layout": layout.plain(),
        "architecture": architecture.plain(),
        "config": config,
    }


def load_policy(path: Path, here: Layout, *, more: bool = False) -> tuple[Deterministic, dict[str, Any]]:
    """The policy of a file or run folder, on the CPU, and the resolved settings that made it.

    A folder gives its best policy. Raises CheckpointError if the file is
    unreadable, or was made for another layout than that of the environment `here`,
    which with `more` may observe other things beside.
    """
    file = find(path, BEST_POLICY_FILE, CHECKPOINT_FILE)
    content = read(file, "policy", "checkpoint")
    layout = Layout.from_plain(content["layout"])
    layout.require(here.only(layout.keys) if more else here, str(file))
    module = make_policy(layout, Architecture.from_plain(content["architecture"]))
    weights = content["policy"] if content["kind"] == "policy" else content["learner"]["policy"]
    module.load_state_dict(weights)
    return Deterministic(module), content["config"]
