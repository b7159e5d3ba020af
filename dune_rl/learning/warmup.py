"""Warm-up policies, which drive at the beginning of a training in place of the learners' policies."""

from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase

from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.policies import UniformRandom


class WarmUp:
    """The warm-up of each group of agents: a scripted policy, or random actions, for some frames.

    `groups` are those that are warmed up in the present phase. The phase ends with the warm-up of any of
    them, as groups that warm up for fewer frames then act by their learner's policy beside the others.
    """

    def __init__(self, learners: Mapping[str, Algorithm]) -> None:
        self._learners = learners
        self._is_random = False
        self.groups: frozenset[str] = frozenset()

    def goes_on(self, frames: int) -> bool:
        """Whether another than the learners' policies drives after `frames`, at least in one group."""
        return bool(self._warmed_up(frames))

    def is_over(self, frames: int) -> bool:
        """Whether the present phase of the warm-up is over after `frames`."""
        return self._warmed_up(frames) != self.groups

    @property
    def stage(self) -> int:
        """The number of the present phase, from 1 on; 0 where the learners' policies alone drive."""
        if not self.groups:
            return 0
        return 1 + sum(learner.warmup_frames > 0 for learner in self._learners.values()) - len(self.groups)

    def begin_phase(self, frames: int) -> dict[str, TensorDictModuleBase]:
        """The policies of the warm-up that drive after `frames`, by group; none where it is over."""
        self.groups = self._warmed_up(frames)
        found: dict[str, TensorDictModuleBase] = {}
        for group in sorted(self.groups):
            learner = self._learners[group]
            found[group] = learner.warmup_policy() or UniformRandom(group, learner.context.spec)
        self._is_random = all(isinstance(policy, UniformRandom) for policy in found.values())
        return found

    def learners_policies(self) -> dict[str, GroupPolicy]:
        """The learners' policies of the groups that are not warmed up in the present phase."""
        return {
            group: learner.policy for group, learner in self._learners.items() if group not in self.groups
        }

    def describe(self, frames: int) -> str | None:
        """The warm-up after `frames`, "scripted" or "random"; None where the learners' policies drive."""
        if not self.goes_on(frames):
            return None
        return "random" if self._is_random else "scripted"

    def _warmed_up(self, frames: int) -> frozenset[str]:
        return frozenset(group for group, learner in self._learners.items() if frames < learner.warmup_frames)
