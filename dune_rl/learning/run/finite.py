"""Updates and weights that are not finite: such an update is left out, and lost weights end a run."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from dune_rl.core.errors import DivergenceError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.optimiser import FiniteAdam

# Updates that are left out one after another, from which on no update will be a good one.
_MOST_IN_A_ROW = 100


class SkippedUpdates:
    """Counts the updates that are left out, and calls `announce` with a line at the first of each group."""

    def __init__(self, learners: Mapping[str, Algorithm], announce: Callable[[str], None]) -> None:
        self._learners, self._announce = learners, announce
        self._counts = dict.fromkeys(learners, 0)

    def check(self) -> None:
        """Count the updates that were left out; raises DivergenceError where a learner makes no others."""
        for group, learner in self._learners.items():
            optimiser = learner.optimiser
            if not isinstance(optimiser, FiniteAdam):
                # Before the environment is given its actions.
                _check_policy(group, learner)
                continue
            skipped, in_a_row = torch.stack([optimiser.skipped, optimiser.in_a_row]).tolist()
            if skipped and not self._counts[group]:
                self._announce(
                    f"note: an update of {group} had a loss or gradients that are not finite, and was left "
                    "out. TensorBoard counts such updates as faults/skipped_updates"
                )
            self._counts[group] = int(skipped)
            if in_a_row >= _MOST_IN_A_ROW:
                raise DivergenceError(
                    f"the training of {group} diverged: {in_a_row:.0f} updates in a row had a loss or "
                    "gradients that are not finite"
                )

    def scalars(self) -> dict[str, float]:
        """The count, where it is not zero, by the name of its log."""
        count = sum(self._counts.values())
        return {"faults/skipped_updates": float(count)} if count else {}


def check_weights(learners: Mapping[str, Algorithm]) -> None:
    """Raise DivergenceError where weights are not finite, or anything else of a learner's state is NaN."""
    for group, learner in learners.items():
        _check_policy(group, learner)
        if any(values.isnan().any() for values in _numbers(learner.state_dict())):
            raise DivergenceError(f"the training of {group} diverged: a part of its learner's state is NaN")


def _check_policy(group: str, learner: Algorithm) -> None:
    # One number for all, which is read once.
    if not nn.utils.get_total_norm([each.detach() for each in learner.policy.parameters()]).isfinite():
        raise DivergenceError(f"the training of {group} diverged: its policy's weights are not finite")


def _numbers(state: Any) -> Iterator[Tensor]:
    """The tensors of floating-point numbers in nested containers."""
    if isinstance(state, Tensor):
        if state.is_floating_point():
            yield state
    elif isinstance(state, Mapping | list | tuple):
        for each in state.values() if isinstance(state, Mapping) else state:
            yield from _numbers(each)
