"""The goal sensor: distance and bearing of an agent's goal."""

import numpy as np

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.sensors.sensor import PI32, Bounds, Reading
from dune_rl.state.state import GroupState, State


class Goal:
    """The reading `name`, (N, 2): horizontal distance [m], at most `farthest_m`, and bearing [rad].

    The bearing is measured from the agent's heading, counter-clockwise, in [-pi, pi).
    """

    def __init__(self, num_rows: int, farthest_m: float, name: str = "goal") -> None:
        self._name, self._farthest_m = name, farthest_m
        self._reading: Floats = np.zeros((num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Distances up to the farthest, and whole turns."""
        low, high = [0.0, -PI32], [self._farthest_m, PI32]
        return {self._name: (np.array(low, np.float32), np.array(high, np.float32))}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present goal."""
        reading = np.empty((len(now.goal.distance), 2), np.float32)
        reading[:, 0] = np.minimum(now.goal.distance, self._farthest_m)
        reading[:, 1] = now.goal.bearing
        self._reading = reading

    def read(self) -> dict[str, Reading]:
        """The latest distance and bearing."""
        return {self._name: self._reading.copy()}
