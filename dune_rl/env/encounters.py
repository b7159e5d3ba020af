"""Collisions counted as encounters: however long the rover pushes against a thing, it met it once."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


class Encounters:
    """When each of M rovers last touched each of B bodies.

    A touch begins an encounter unless the same body was touched within the
    last `gap_steps` control steps.
    """

    def __init__(self, num_scenes: int, bodies: int, gap_steps: int) -> None:
        self._gap = gap_steps
        self._last = np.full((num_scenes, bodies), -gap_steps - 1, np.int64)

    def make_room(self, bodies: int) -> None:
        """Count as many bodies as `bodies`, or more: scenes may hold different numbers."""
        more = bodies - self._last.shape[1]
        if more > 0:
            unmet = np.full((len(self._last), more), -self._gap - 1, np.int64)
            self._last = np.concatenate([self._last, unmet], axis=1)

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Forget every touch in the scenes in `mask` (M,)."""
        self._last[mask] = -self._gap - 1

    def update(
        self, touches: Iterable[tuple[int, int]], steps: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Encounters that begin now, and whether anything is touched, each (M,).

        `touches` are pairs of scene and body, which may repeat; `steps` (M,)
        counts each episode's control steps.
        """
        begun = np.zeros(len(self._last), np.int64)
        touching = np.zeros(len(self._last), bool)
        for scene, body in set(touches):
            begun[scene] += steps[scene] - self._last[scene, body] > self._gap
            self._last[scene, body] = steps[scene]
            touching[scene] = True
        return begun, touching
