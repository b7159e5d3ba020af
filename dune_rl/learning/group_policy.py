"""Agent groups in TorchRL data: their policies, and their part of a collected batch."""

from collections.abc import Callable, Iterable
from typing import Protocol

import torch
from tensordict import TensorDict, TensorDictBase
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


# Under a group, what a policy of `PopulationPolicy` adds: whether a past policy acted, bool (M, T, G, 1).
PAST = "acted_by_past"


def acted_by_past(batch: TensorDictBase, group: str) -> torch.Tensor | None:
    """Flags (M, T) of steps in which a past policy acted for `group`; None where none ever does."""
    flags = batch.get((group, PAST), None)
    return None if flags is None else flags[..., 0, 0]


def select_group(batch: TensorDictBase, group: str) -> TensorDictBase:
    """What a collected batch (M scenes, T steps) holds of the G agents of `group`, with batch size (M, T, G).

    Entries are "observation", "action", "done" and so on, and the same under "next" after the step. An agent
    is "done" after the step at its own end or at its episode's, so that no sequence goes on into the next
    episode; "done" before the step marks an agent that ended earlier in this episode, or has not come yet,
    and idles, and one that acted by a past policy, of which nothing is learned.
    """
    now, after = batch.get(group), batch.get(("next", group))
    past = now.get(PAST, None)
    if past is not None:
        # A copy of the shell: the batch itself is left as it is.
        now = now.exclude(PAST).set("done", now.get("done") | past)
    ended = batch.get(("next", "done")).unsqueeze(-2)
    following = TensorDict(dict(after.items()) | {"done": after.get("done") | ended}, after.batch_size)
    return TensorDict(dict(now.items()) | {"next": following}, now.batch_size)


def agent_sequences(group_batch: TensorDictBase) -> TensorDictBase:
    """The steps of each agent in order, batch size (M * G, T), from what `select_group` gives."""
    steps = group_batch.batch_size[1]
    return group_batch.permute(0, 2, 1).reshape(-1, steps)
