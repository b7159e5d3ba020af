"""Log of all actions of the running episodes, which with the seed suffices to restore a simulation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Floats

_FIRST_LENGTH = 64


class ActionLog:
    """The actions of M scenes since their episodes began, `width` numbers in each step."""

    def __init__(self, num_scenes: int, width: int) -> None:
        self._rows = np.zeros((num_scenes, _FIRST_LENGTH, width), np.float32)
        self._scenes = np.arange(num_scenes)

    def add(self, steps: NDArray[np.int64], actions: Sequence[NDArray[np.floating]]) -> None:
        """Record the `actions` of each group, (M, ...), at each scene's step `steps` (M,)."""
        if int(steps.max()) >= self._rows.shape[1]:
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)], axis=1)
        scenes, first = self._scenes, 0
        for values in actions:
            flat = values.reshape(len(scenes), -1)
            self._rows[scenes, steps, first : first + flat.shape[1]] = flat
            first += flat.shape[1]

    def plain(self, steps: NDArray[np.int64]) -> list[list[list[float]]]:
        """Each scene's actions so far, its first `steps` (M,), as plain numbers, exact in float32."""
        return [self._rows[scene, :count].tolist() for scene, count in enumerate(steps.tolist())]

    def aligned(self, plain: list[list[list[float]]]) -> Floats:
        """What `plain` gave as rows (longest, M, width), each scene's last action in the last row."""
        longest = max((len(actions) for actions in plain), default=0)
        rows = np.zeros((longest, len(plain), self._rows.shape[2]), np.float32)
        for scene, actions in enumerate(plain):
            if actions:
                rows[longest - len(actions) :, scene] = np.array(actions, np.float32)
        return rows
