"""The interface of a learning algorithm: the trainer calls one learner for each agent group."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.policy import Architecture, load_weights, make_policy_network
from dune_rl.learning.policy_spec import PolicySpec

# Of the number of scenes and a seed; with a curriculum, also of it, by its name.
MakeEnv = Callable[..., EnvBase]


@dataclass(frozen=True)
class LearnerContext:
    """The group, observation and action sizes, and run that a learner is built for.

    The group has `num_agents` agents in each scene; the run takes `total_frames`. `algorithm` is the
    registered name of the algorithm. The learner may write temporary data to `folder`.
    """

    group: str
    num_agents: int
    spec: PolicySpec
    total_frames: int
    folder: Path
    device: torch.device
    algorithm: str
    # `spec` with the privileged parts of the observation, if there are any.
    critic_spec: PolicySpec | None = None

    @property
    def whole_spec(self) -> PolicySpec:
        """What critics observe: the policy's spec, and parts that are privileged."""
        return self.critic_spec or self.spec


class Algorithm(ABC):
    """The learner of one agent group: networks, losses, and a buffer of collected data.

    For each collected batch the trainer calls `absorb`, then `update`; then the group acts by `policy`. The
    learner decides how long it stores a batch: an off-policy one fills a replay buffer, an on-policy one
    stores a batch until it has been used. Frames are control steps, counted over all scenes; they do not
    depend on the number of agents.

    A subclass implements `absorb` and `update`; it sets `architecture` before it calls `super().__init__`, or
    overrides `make_network` and `network_settings`. It adds all further state to `state_dict`.
    """

    architecture = Architecture((256, 256))
    # False: the group acts by its policy, and nothing is learned.
    learns = True
    # Where it is a `FiniteAdam`, the trainer counts the updates that are left out.
    optimiser: torch.optim.Optimizer | None = None
    # Other algorithms whose policies have the same networks, and can be started from.
    starts_from: tuple[str, ...] = ()

    def __init__(self, context: LearnerContext) -> None:
        self.context = context
        self.updates = 0
        self.policy = self.make_policy(context.device)

    @abstractmethod
    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Store a batch (M, T, G) of the group from `select_group`, on the CPU; do not change it.

        `frames` is the number of frames collected so far, including this batch.
        """

    @abstractmethod
    def update(self) -> dict[str, float]:
        """Do the gradient updates that are due, counted in `updates`; returns scalars to log by name."""

    def distributions(self) -> dict[str, Tensor]:
        """Values to log as histograms by name, at each evaluation; changes no state, random ones included."""
        return {}

    def make_policy(self, device: torch.device | str = "cpu") -> GroupPolicy:
        """A policy of the same architecture as `policy`, with newly initialised weights."""
        network = self.make_network(self.context.spec, self.network_settings(), device)
        return GroupPolicy(self.context.group, self.context.spec, network)

    @property
    def warmup_frames(self) -> int:
        """Frames in which `warmup_policy` acts instead of `policy`."""
        return 0

    def warmup_policy(self) -> TensorDictModuleBase | None:
        """The policy that acts in the first `warmup_frames`; None: uniformly random actions."""
        return None

    def check_environment(self, env: EnvBase) -> None:  # noqa: B027
        """Raise ConfigError, before data are collected, where the learner cannot learn in such as `env`."""

    def wrap_environment(self, make_env: MakeEnv, *, warms_up: bool) -> MakeEnv:
        """What makes the environments that data are collected in: `make_env` and what the learner adds.

        `warms_up` tells whether they are those of the first `warmup_frames`. The result must be picklable.
        """
        return make_env

    @classmethod
    def make_network(
        cls, spec: PolicySpec, settings: Mapping[str, Any], device: torch.device | str = "cpu"
    ) -> TensorDictModuleBase:
        """The policy's network with newly initialised weights, from the result of `network_settings`."""
        return make_policy_network(spec, Architecture.from_plain(settings), device)

    def network_settings(self) -> dict[str, Any]:
        """Settings that, with the spec, determine the policy's network, as plain containers."""
        return self.architecture.plain()

    def state_dict(self) -> dict[str, Any]:
        """All state of the learner, as containers that `torch.load(weights_only=True)` reads."""
        return {"policy": dict(self.policy.network.state_dict()), "updates": self.updates}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state_dict`."""
        load_weights(self.policy.network, state["policy"])
        self.updates = state["updates"]

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the weights of an earlier run's learner: its `state_dict`, or its policy's alone."""
        load_weights(self.policy.network, saved["policy"])

    def has_new_critics(self, entry: Mapping[str, Any]) -> bool:
        """Whether critics begin with random weights in a run that starts from a file's `entry`."""
        return "learner" not in entry

    def save_experience(self, path: Path) -> dict[str, Any] | None:
        """Write collected data that is too large for the checkpoint to a file: `path` with a suffix.

        Returns plain data for `load_experience`, with the file's name under "file"; None: nothing was saved.
        """
        return None

    def load_experience(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """The inverse of `save_experience`, from the `folder` that the file is in."""
        raise NotImplementedError(f"{type(self).__name__} saves no experience")

    def close(self) -> None:  # noqa: B027
        """Release files and processes; the learner must not be used afterwards."""


def mean_values(updates: Iterable[Mapping[str, Tensor]]) -> dict[str, float]:
    """The means of the scalars that several gradient updates give by the same names.

    They are summed where they are, and read once: each reading would wait for a GPU.
    """
    totals: dict[str, Tensor] = {}
    count = 0
    for values in updates:
        for key, value in values.items():
            totals[key] = totals[key] + value if key in totals else value
        count += 1
    return {key: float(value) / count for key, value in totals.items()}
