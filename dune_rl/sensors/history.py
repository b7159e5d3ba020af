"""Readings of a moment ago, from which motion can be told."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


class History:
    """The last readings (M, n) of a sensor, `delay_steps` control steps deep."""

    def __init__(self, num_scenes: int, size: int, delay_steps: int) -> None:
        self._ring = np.zeros((delay_steps + 1, num_scenes, size), np.float32)
        self._newest = 0
        self.delay_steps = delay_steps

    def restart(self, mask: NDArray[np.bool_], reading: Floats) -> None:
        """Let the scenes in `mask` (M,) have read nothing but `reading` (M, n) so far."""
        self._ring[:, mask] = reading[mask]

    def push(self, reading: Floats) -> None:
        """Add the reading (M, n) of a control step."""
        self._newest = (self._newest + 1) % len(self._ring)
        self._ring[self._newest] = reading

    def now(self) -> Floats:
        """The newest reading (M, n)."""
        return self._ring[self._newest].copy()

    def past(self) -> Floats:
        """The reading of `delay_steps` ago (M, n), or the episode's first where it is younger."""
        return self._ring[(self._newest + 1) % len(self._ring)].copy()
