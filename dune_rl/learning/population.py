"""A population of past policies, which act as opponents in a share of the training's episodes."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs.transforms import Transform

from dune_rl.core.errors import ConfigError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.group_policy import PAST, Deterministic, GroupPolicy
from dune_rl.learning.settings import PopulationConf
from dune_rl.sensors.draws import uniform

# The entry at the root of the environment's data: the draws (M, W) of each scene's present episode.
DRAWS = "opponent_draws"
# Whether there are past opponents, and which group acts as it does at present; then one for each group.
_COMMON_DRAWS = 2


class OpponentDraws(Transform):
    """Adds the draws (M, W) that decide which policies of `num_groups` groups act in an episode.

    They are uniform in [0, 1), and depend on (seed, episode) alone. The environment must have `episode_keys`.
    """

    def __init__(self, num_groups: int) -> None:
        super().__init__()
        self._width = _COMMON_DRAWS + num_groups

    def _add(self, tensordict: TensorDictBase) -> TensorDictBase:
        seed, episodes = self.parent.base_env.episode_keys()
        draws = uniform(seed, "opponents", episodes, 0 * episodes, self._width)
        return tensordict.set(DRAWS, torch.from_numpy(draws))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._add(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._add(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        shape = (*observation_spec.shape, self._width)
        observation_spec[DRAWS] = Unbounded(shape, dtype=torch.float32)
        return observation_spec


class PopulationPolicy(GroupPolicy):
    """A group's policy, `present`, and `conf.size` places for past ones of the same architecture.

    For an episode that begins, its draws (`OpponentDraws`) decide which policy acts in it to its end: the
    present one, or one of the first `filled` places. `number` is the group's among `num_groups`. Beside
    the action it writes under the group whether a past policy acted.
    """

    filled: Tensor

    def __init__(
        self,
        present: GroupPolicy,
        past: list[GroupPolicy],
        conf: PopulationConf,
        number: int,
        num_groups: int,
    ) -> None:
        super().__init__(present.group, present.policy_spec, present.network)
        self.past = torch.nn.ModuleList(past)
        self.register_buffer("filled", torch.zeros((), dtype=torch.int64))
        self._probability, self._number, self._num_groups = conf.probability, number, num_groups
        self.in_keys: list[Any] = [*self.in_keys, DRAWS]
        self.out_keys = [*self.out_keys, (self.group, PAST)]
        self._draws, self._chosen = torch.zeros(0, 0), torch.zeros(0, dtype=torch.int64)

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes the actions, and whether a past policy acted; scenes are the first axis."""
        self._begin_episodes(observation.get(DRAWS))
        # For all scenes: a small network takes as long for a part of them.
        observation = super().forward(observation)
        parts = observation.get(self.group)
        is_past = self._chosen >= 0
        if is_past.any():
            action = parts.get("action").clone()
            for place in self._chosen[is_past].unique().tolist():
                scenes = self._chosen == place
                seen = parts.get("observation")[scenes]
                act = Deterministic(self.past[place].network)
                action[scenes] = act(seen.copy()).get("action")
            parts.set("action", action)
        flags = is_past.view(-1, *[1] * len(parts.batch_size)).expand(*parts.batch_size, 1)
        parts.set(PAST, flags.clone())
        return observation

    def _begin_episodes(self, draws: Tensor) -> None:
        """Choose the policies that act in the scenes whose episodes are new, by their `draws` (M, W)."""
        if self._draws.shape != draws.shape:
            # No draw is negative: all episodes are new.
            self._draws = torch.full_like(draws, -1.0)
            self._chosen = torch.full((len(draws),), -1, dtype=torch.int64)
        begins = (draws != self._draws).any(-1)
        if not begins.any():
            return
        filled = int(self.filled)
        places = (draws[:, _COMMON_DRAWS + self._number] * filled).long()
        at_present = (draws[:, 1] * self._num_groups).long() == self._number
        is_past = (draws[:, 0] < self._probability) & ~at_present & (filled > 0)
        self._chosen = torch.where(begins, torch.where(is_past, places, -1), self._chosen)
        self._draws = draws.clone()

    def episodes(self) -> dict[str, Tensor]:
        """The policies that act in the present episodes, as plain data."""
        return {"draws": self._draws, "chosen": self._chosen}

    def resume_episodes(self, saved: Mapping[str, Tensor]) -> None:
        """The inverse of `episodes`; places that are empty now, as of another size than then, act no more."""
        self._draws, chosen = saved["draws"], saved["chosen"]
        self._chosen = torch.where(chosen < self.filled, chosen, -1)

    def fill(self, snapshots: list[Mapping[str, Tensor]]) -> None:
        """Put the weights of past policies into the first places."""
        for policy, weights in zip(self.past, snapshots, strict=False):
            policy.load_state_dict(weights)
        self.filled.fill_(len(snapshots))


class Population:
    """The snapshots of the groups that learn (`learners`), of which the latest `conf.size` are kept.

    A new snapshot replaces the oldest, also in running episodes.
    """

    def __init__(self, conf: PopulationConf, learners: Mapping[str, Algorithm]) -> None:
        self.conf, self._learners = conf, learners
        self.snapshots: dict[str, list[Mapping[str, Tensor]]] = {group: [] for group in learners}
        self._taken = 0
        self._next_at = conf.every_frames

    def take_if_due(self, frames: int) -> bool:
        """Take a snapshot of every group if one is due after `frames`; returns whether it did."""
        if frames < self._next_at:
            return False
        while self._next_at <= frames:
            self._next_at += self.conf.every_frames
        place = self._taken % self.conf.size
        for group, learner in self._learners.items():
            weights = {
                key: value.detach().cpu().clone() for key, value in learner.policy.state_dict().items()
            }
            self.snapshots[group][place : place + 1] = [weights]
        self._taken += 1
        return True

    def __len__(self) -> int:
        return min(self._taken, self.conf.size)

    def join(self, policies: Mapping[str, TensorDictModuleBase]) -> dict[str, TensorDictModuleBase]:
        """`policies` by group, with places for past policies in the groups that learn."""
        joined = dict(policies)
        for number, (group, learner) in enumerate(self._learners.items()):
            present = policies[group]
            assert isinstance(present, GroupPolicy)
            past = [learner.make_policy() for _ in range(self.conf.size)]
            joined[group] = PopulationPolicy(present, past, self.conf, number, len(self._learners))
        return joined

    @property
    def num_groups(self) -> int:
        return len(self._learners)

    def state(self) -> dict[str, Any]:
        return {
            "snapshots": {group: list(map(dict, found)) for group, found in self.snapshots.items()},
            "taken": self._taken,
            "next_at": self._next_at,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state`; with another size than then, the pool begins anew."""
        self._next_at = state["next_at"]
        kept = state["snapshots"]
        if kept.keys() == self.snapshots.keys() and len(next(iter(kept.values()))) == min(
            state["taken"], self.conf.size
        ):
            self.snapshots = {group: list(found) for group, found in kept.items()}
            self._taken = state["taken"]


def make_population(conf: PopulationConf, learners: Mapping[str, Algorithm]) -> Population | None:
    """The population of the groups that learn; None without one, and where a group has no others to meet.

    Raises ConfigError where a policy is recurrent.
    """
    learning = {group: each for group, each in learners.items() if each.learns}
    if not conf.probability or len(learning) == 1:
        return None
    for group, learner in learning.items():
        if learner.policy.is_recurrent:
            raise ConfigError(
                f"learning.population.probability: the policy of {group} is recurrent, and past policies "
                "have no memory; set it to 0, or learning.recurrent=0"
            )
    return Population(conf, learning)
