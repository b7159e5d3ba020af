"""The interface of a learning algorithm: what the trainer needs to know of one group's learner."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.architecture import Architecture
from dune_rl.learning.networks.policy import make_policy_network
from dune_rl.learning.policy_spec import PolicySpec


@dataclass(frozen=True)
class LearnerContext:
    """What a learner is made for: its group of `num_agents` agents a scene, and the run of `total_frames`.

    `algorithm` is the algorithm's name. `folder` is where it may keep data while it runs.
    """

    group: str
    num_agents: int
    spec: PolicySpec
    total_frames: int
    folder: Path
    device: torch.device
    algorithm: str


class Algorithm(ABC):
    """The learner of one agent group: its networks, its losses, and what it keeps of the collected data.

    For each collected batch the trainer calls `absorb`, then `update`, and then
    lets the group act by `policy`. What is kept of a batch, and for how long, is
    the learner's own matter: an off-policy one fills a replay buffer, an
    on-policy one holds the batch until it has been learned from. Frames are
    control steps, counted over all scenes, however many agents there are.

    A subclass implements `absorb` and `update`; it sets `architecture` before it
    calls `super().__init__`, or overrides `make_network` and `network_settings`.
    It adds what else it changes to `state_dict`.
    """

    architecture = Architecture((256, 256))

    def __init__(self, context: LearnerContext) -> None:
        self.context = context
        self.updates = 0
        self.policy = self.make_policy(context.device)

    # -- learning -------------------------------------------------------------------------------------

    @abstractmethod
    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Take a batch (M, T, G) of the group, as `select_group` gives it, on the CPU.

        `frames` have been collected in all by now. It must not be changed.
        """

    @abstractmethod
    def update(self) -> dict[str, float]:
        """Do the updates that are due, counted in `updates`, and return figures to log by name."""

    # -- acting ---------------------------------------------------------------------------------------

    def make_policy(self, device: torch.device | str = "cpu") -> GroupPolicy:
        """A policy with fresh weights, to which those of `policy` can be copied."""
        network = self.make_network(self.context.spec, self.network_settings(), device)
        return GroupPolicy(self.context.group, self.context.spec, network)

    @property
    def warmup_frames(self) -> int:
        """Frames in which `warmup_policy` acts instead of `policy`."""
        return 0

    def warmup_policy(self) -> TensorDictModuleBase | None:
        """Who acts in the first `warmup_frames`; None: uniformly random actions."""
        return None

    @classmethod
    def make_network(
        cls, spec: PolicySpec, settings: Mapping[str, Any], device: torch.device | str = "cpu"
    ) -> TensorDictModuleBase:
        """The policy's network with fresh weights, from what `network_settings` gave."""
        return make_policy_network(spec, Architecture.from_plain(settings), device)

    def network_settings(self) -> dict[str, Any]:
        """What shapes the policy's network beside the spec, as plain containers."""
        return self.architecture.plain()

    # -- saving ---------------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """All that learning has changed, as containers that `torch.load(weights_only=True)` reads."""
        return {"policy": dict(self.policy.network.state_dict()), "updates": self.updates}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state_dict`."""
        self.policy.network.load_state_dict(state["policy"])
        self.updates = state["updates"]

    def save_experience(self, path: Path) -> dict[str, Any] | None:
        """Write collected data that is too large for the checkpoint to a file: `path` with a suffix.

        Returns what `load_experience` needs beside the file, which "file" names; None: there is none.
        """
        return None

    def load_experience(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """The inverse of `save_experience`, from the `folder` that the file is in."""
        raise NotImplementedError(f"{type(self).__name__} saves no experience")

    def close(self) -> None:  # noqa: B027
        """Free what the learner holds beside memory; it learns no more."""
