"""A group that acts by a policy from a file and does not learn."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

from dune_rl.core.errors import CheckpointError
from dune_rl.learning.algorithm import Algorithm, LearnerContext
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.policy_spec import GroupMismatchError, PolicyMismatchError
from dune_rl.learning.saved_policies import read_saved_policy


class FrozenGroupPolicy(GroupPolicy):
    """A group's policy that acts without noise, also while data are collected."""

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes the action of every agent, done or not."""
        return Deterministic(super().forward)(observation)


class FrozenPolicy(Algorithm):
    """The learner of a group that is not to learn: it acts by the policy for the group in `path`.

    Raises CheckpointError, which names the setting, for a file that has no policy for what the group observes
    and does.
    """

    def __init__(self, context: LearnerContext, path: Path) -> None:
        try:
            self._saved = read_saved_policy(path, context.group, context.spec)
        except PolicyMismatchError as error:
            message = f"learning.groups.{context.group}.frozen: {error}"
            raise GroupMismatchError(message, context.group, str(path)) from None
        except CheckpointError as error:
            raise CheckpointError(f"learning.groups.{context.group}.frozen: {error}") from None
        super().__init__(replace(context, spec=self._saved.spec, algorithm=self._saved.algorithm))

    def make_policy(self, device: torch.device | str = "cpu") -> GroupPolicy:
        """The policy with its weights."""
        return FrozenGroupPolicy(self.context.group, self._saved.spec, self._saved.make_network(device))

    def network_settings(self) -> dict[str, Any]:
        """Those in the file."""
        return dict(self._saved.network)

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Learns nothing."""

    def update(self) -> dict[str, float]:
        """Learns nothing."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The weights that the run began with, even if the file has others now."""
        super().load_state_dict(state)
        self._saved = replace(self._saved, weights=dict(state["policy"]))
