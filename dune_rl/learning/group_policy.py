"""Agent groups in TorchRL data: their policies, and their part of a collected batch."""

from collections.abc import Callable, Iterable
from typing import Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.policy import BEGINS, MEMORY
from dune_rl.learning.policy_spec import PolicySpec


class Policy(Protocol):
    """Writes (group, "action") (M, G, A) into what M scenes observe, for one group or for several."""

    def __call__(self, observation: TensorDictBase) -> TensorDictBase: ...


class GroupPolicy(TensorDictModuleBase):
    """Lets all agents of `group` act by one network, which they share.

    `network` maps the entries of (group, "observation"), batch size (..., G), to
    those in `outputs`, "action" (..., G, A) among them, which are written under `group`.

    A recurrent network's memory is kept here from call to call, and written under `group` as it was before
    the step. It is emptied where an agent's episode begins: (`group`, `BEGINS`) of the observation, which
    `EpisodeBegins` adds, or what `watch` reads.
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
        # Networks of others state no inputs beside the observation.
        self.is_recurrent = MEMORY in network.in_keys
        self.memory: Tensor | None = None
        self._env: EnvBase | None = None
        if self.is_recurrent:
            self.out_keys.append((group, MEMORY))

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        # A shallow copy, so that what the network writes in between does not become an observation.
        parts = observation.get((self.group, "observation")).copy()
        if self.is_recurrent:
            begins = self._begins(observation)
            parts.set(BEGINS, begins)
            if self.memory is not None and self.memory.shape[:-2] == parts.batch_size:
                parts.set(MEMORY, torch.where(begins.unsqueeze(-1), 0.0, self.memory))
        result = self.network(parts)
        for key in self._outputs:
            observation.set((self.group, key), result.get(key))
        if self.is_recurrent:
            after = result.get(("next", MEMORY))
            observation.set((self.group, MEMORY), result.get(MEMORY, torch.zeros_like(after)))
            self.memory = after.detach()
        return observation

    def watch(self, env: EnvBase) -> None:
        """Take from `env`, which must run in this process, where episodes begin."""
        self._env = env

    def _begins(self, observation: TensorDictBase) -> Tensor:
        begins: Tensor | None = observation.get((self.group, BEGINS), None)
        if begins is not None:
            return begins
        if self._env is None:
            raise ConfigError(
                f"the policy of {self.group} is recurrent and cannot tell where episodes begin; append "
                "dune_rl.learning.episode_begins.EpisodeBegins to the environment"
            )
        return read_begins(self._env, self.group)


def read_begins(env: EnvBase, group: str) -> Tensor:
    """Whether no step of their episode has been made yet by the agents of `group`, bool (M, G, 1)."""
    return torch.from_numpy(env.episode_begins(group)).unsqueeze(-1)


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


def select_group(batch: TensorDictBase, group: str, faulty: torch.Tensor | None = None) -> TensorDictBase:
    """What a collected batch (M scenes, T steps) holds of the G agents of `group`, with batch size (M, T, G).

    Entries are "observation", "action", "done" and so on, and the same under "next" after the step. An agent
    is "done" after the step at its own end or at its episode's, so that no sequence goes on into the next
    episode; "done" before the step marks an agent that ended earlier in this episode, or has not come yet,
    and idles, and one that acted by a past policy, of which nothing is learned. Steps that are `faulty`
    (M, T) are marked as well, and the steps before them as the last of their sequences.
    """
    now, after = batch.get(group), batch.get(("next", group))
    past = now.get(PAST, None)
    if past is not None:
        # A copy of the shell: the batch itself is left as it is.
        now = now.exclude(PAST).set("done", now.get("done") | past)
    ended = batch.get(("next", "done")).unsqueeze(-2)
    if faulty is not None:
        now = now.copy().set("done", now.get("done") | faulty[..., None, None])
        ended = ended.clone()
        ended[:, :-1] |= faulty[:, 1:, None, None]
    following = TensorDict(dict(after.items()) | {"done": after.get("done") | ended}, after.batch_size)
    return TensorDict(dict(now.items()) | {"next": following}, now.batch_size)


def agent_sequences(group_batch: TensorDictBase) -> TensorDictBase:
    """The steps of each agent in order, batch size (M * G, T), from what `select_group` gives."""
    steps = group_batch.batch_size[1]
    return group_batch.permute(0, 2, 1).reshape(-1, steps)
