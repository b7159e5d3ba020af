"""Policies of agent groups: from (group, "observation") to (group, "action")."""

from collections.abc import Callable, Iterable
from typing import Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dune_rl.learning.policy_spec import PolicySpec


class Policy(Protocol):
    """Writes (group, "action") (M, G, A) into what M scenes observe, for one group or for several."""

    def __call__(self, observation: TensorDictBase) -> TensorDictBase: ...


class GroupPolicy(TensorDictModuleBase):
    """Lets all agents of `group` act by one network, which they share.

    `network` maps the entries of (group, "observation"), batch size (..., G), to
    those in `outputs`, "action" (..., G, A) among them, which are written under `group`.
    """

    def __init__(
        self,
        group: str,
        spec: PolicySpec,
        network: TensorDictModuleBase,
        outputs: Iterable[str] = ("action",),
    ) -> None:
        super().__init__()
        self.group, self.policy_spec = group, spec
        self.network = network
        self._outputs = tuple(outputs)
        self.in_keys = [(group, "observation", key) for key in spec.keys]
        self.out_keys = [(group, key) for key in self._outputs]

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes the action of every agent, done or not."""
        # A shallow copy, so that what the network writes in between does not become an observation.
        result = self.network(observation.get((self.group, "observation")).copy())
        for key in self._outputs:
            observation.set((self.group, key), result.get(key))
        return observation


class JointPolicy(TensorDictModuleBase):
    """Lets several groups act, each by its own policy."""

    def __init__(self, policies: Iterable[TensorDictModuleBase]) -> None:
        super().__init__()
        members = list(policies)
        self.policies = torch.nn.ModuleList(members)
        self.in_keys = [key for policy in members for key in policy.in_keys]
        self.out_keys = [key for policy in members for key in policy.out_keys]

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes the actions of all groups."""
        for policy in self.policies:
            observation = policy(observation)
        return observation


class Deterministic:
    """The most likely behaviour of a trained policy: the squashed location of its distribution."""

    def __init__(self, module: Callable[[TensorDictBase], TensorDictBase]) -> None:
        self._module = module

    @torch.no_grad()
    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        """Acts without noise and without changing the module's statistics."""
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return self._module(observation)
