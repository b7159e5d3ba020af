"""An instrument that reads what it is told, and moments that are no more than a place in an episode."""

import numpy as np

from dune_rl.sensors.sensor import Bounds, Moment


def moment(episodes, steps, seed: int = 5) -> Moment:
    """Rovers that all stand at the origin, at `steps` of `episodes`."""
    scenes = len(np.atleast_1d(episodes))
    zero = np.zeros((scenes, 3))
    episodes, steps = (
        np.broadcast_to(np.asarray(each, np.int64), scenes).copy() for each in (episodes, steps)
    )
    rotation = np.tile(np.eye(3), (scenes, 1, 1))
    return Moment(
        zero, rotation, zero, zero, zero, zero, zero, np.zeros((scenes, 0, 4)), seed, episodes, steps
    )


class Told:
    """A sensor of M scenes whose readings are set by a test in `now`, each (M, ...)."""

    def __init__(self, bounds: dict[str, Bounds], scenes: int) -> None:
        self._bounds = bounds
        self.now = {name: np.zeros((scenes, *low.shape), low.dtype) for name, (low, _) in bounds.items()}
        self.begun: list[np.ndarray] = []

    def bounds(self):
        return self._bounds

    def begin(self, mask, now):
        self.begun.append(mask.copy())

    def measure(self, now):
        pass

    def read(self):
        return {name: reading.copy() for name, reading in self.now.items()}


def limits(high, shape=None, low=None, kind=np.float32) -> Bounds:
    """Bounds of one shape; from -high where no `low` is given."""
    high = np.broadcast_to(np.asarray(high, kind), shape or np.shape(high)).copy()
    return (-high if low is None else np.full(high.shape, low, kind)), high
