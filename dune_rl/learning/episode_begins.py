"""Marks in TorchRL data where the episodes of agents begin, for recurrent policies."""

from collections.abc import Collection

from tensordict import TensorDictBase
from torchrl.data import Binary, TensorSpec
from torchrl.envs.transforms import Transform

from dune_rl.learning.group_policy import read_begins
from dune_rl.learning.networks.policy import BEGINS


class EpisodeBegins(Transform):
    """Adds (group, "is_init") (M, G, 1): whether the agent's episode has no step yet.

    TorchRL's `InitTracker` marks every reset. That of a resumed run returns to the middle of episodes, and
    agents that come later begin without one.
    """

    def __init__(self, groups: Collection[str]) -> None:
        super().__init__()
        self._groups = list(groups)

    def _add(self, tensordict: TensorDictBase) -> TensorDictBase:
        for group in self._groups:
            tensordict.set((group, BEGINS), read_begins(self.parent.base_env, group))
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._add(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._add(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        for group in self._groups:
            observation_spec[group, BEGINS] = Binary(1, shape=(*observation_spec[group].shape, 1))
        return observation_spec
