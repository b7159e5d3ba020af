"""Who drives at the beginning of a training, before the learners' policies do."""

from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase

from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.group_policy import GroupPolicy


class WarmUp:
    """The warm-up of each group of agents: a scripted policy, or random actions, for some frames.

    `scripted` are the groups that have a scripted policy in the present phase.
    """

    def __init__(self, learners: Mapping[str, Algorithm]) -> None:
        self._learners = learners
        self.scripted: frozenset[str] = frozenset()

    def goes_on(self, frames: int) -> bool:
        """Whether a scripted policy or random actions drive after `frames`, at least in one group."""
        return any(frames < learner.warmup_frames for learner in self._learners.values())

    def is_over(self, frames: int) -> bool:
        """Whether this is a phase of scripted policies, of which none drives after `frames` any more."""
        return bool(self.scripted) and not self._policies(frames)

    def begin_phase(self, frames: int) -> dict[str, TensorDictModuleBase]:
        """The scripted policies that drive after `frames`, by group; none where their phase is over."""
        policies = self._policies(frames)
        self.scripted = frozenset(policies)
        return policies

    def random_frames(self, frames: int) -> int:
        """How many frames of random actions come after `frames`; none while scripted policies drive."""
        if self.scripted:
            return 0
        return max(learner.warmup_frames for learner in self._learners.values()) - frames

    def learners_policies(self) -> dict[str, GroupPolicy]:
        """The learners' policies of the groups without a scripted one."""
        return {
            group: learner.policy for group, learner in self._learners.items() if group not in self.scripted
        }

    def describe(self, frames: int) -> str | None:
        """Who drives after `frames`: "scripted" or "random"; None where the learners' policies do."""
        if not self.goes_on(frames):
            return None
        return "scripted" if self.scripted else "random"

    def _policies(self, frames: int) -> dict[str, TensorDictModuleBase]:
        policies = {
            group: learner.warmup_policy()
            for group, learner in self._learners.items()
            if frames < learner.warmup_frames
        }
        return {group: policy for group, policy in policies.items() if policy is not None}
