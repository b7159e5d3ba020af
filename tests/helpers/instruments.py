"""A sensor whose readings are set by a test."""

import numpy as np

from dune_rl.sensors.sensor import Bounds


class ScriptedSensor:
    """A sensor of N rows whose readings are set by a test in `now`, each (N, ...)."""

    def __init__(self, bounds: dict[str, Bounds], rows: int) -> None:
        self._bounds = bounds
        self.now = {name: np.zeros((rows, *low.shape), low.dtype) for name, (low, _) in bounds.items()}
        self.begun: list[np.ndarray] = []

    def bounds(self):
        return self._bounds

    def begin(self, mask, now, state):
        self.begun.append(mask.copy())

    def measure(self, now, state):
        pass

    def read(self):
        return {name: reading.copy() for name, reading in self.now.items()}


def limits(high, shape=None, low=None, kind=np.float32) -> Bounds:
    """Bounds of one shape; from -high where no `low` is given."""
    high = np.broadcast_to(np.asarray(high, kind), shape or np.shape(high)).copy()
    return (-high if low is None else np.full(high.shape, low, kind)), high
