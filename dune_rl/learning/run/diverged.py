"""Steps in which a scene's physics diverged: nothing is learnt from them, and they are counted and told."""

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from dune_rl.tasks.task import DIVERGED


class DivergedScenes:
    """Counts the episodes that diverged physics ended, and calls `announce` with a line at the first.

    They are known by the metric "diverged" of the groups; `columns` are the names of each group's metrics.
    """

    def __init__(self, columns: Mapping[str, Sequence[str]], announce: Callable[[str], None]) -> None:
        self._columns = {
            group: names.index(DIVERGED) for group, names in columns.items() if DIVERGED in names
        }
        self._announce = announce
        self.count = 0

    def find(self, batch: TensorDictBase) -> Tensor | None:
        """Flags (M, T) of the steps of a batch in which a scene's physics diverged; None where in none."""
        ended: Tensor = batch["next", "done"].squeeze(-1)
        if not self._columns or not ended.any():
            return None
        metrics = [batch["next", group, "metrics"][..., column] for group, column in self._columns.items()]
        # One body may have spoilt the states of all others in its scene.
        flags = ended & torch.cat(metrics, -1).gt(0.0).any(-1)
        count = int(flags.sum())
        if not count:
            return None
        if not self.count:
            self._announce(
                "note: the physics of a scene diverged; its episode was ended, and the step is not learnt "
                "from. TensorBoard counts such episodes as faults/diverged_episodes"
            )
        self.count += count
        return flags

    def scalars(self) -> dict[str, float]:
        """The count, where it is not zero, by the name of its log."""
        return {"faults/diverged_episodes": float(self.count)} if self.count else {}
