"""The goal sensor: distance and bearing of an agent's goal."""

from typing import Literal

import numpy as np

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.pipeline import GoalRealismConf
from dune_rl.sensors.sensor import PI32, Bounds, Reading
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class GoalConf(SensorSettings):
    """A goal has nothing to set beside its realism."""

    sensor: Literal["goal"] = "goal"
    realism: GoalRealismConf | None = None


class Goal:
    """The reading `name`, (N, 2): horizontal distance [m], at most the extent's diagonal, and bearing [rad].

    The bearing is measured from the agent's heading, counter-clockwise, in [-pi, pi). A robot that navigates
    by faulty instruments knows the goal's coordinates, its own position by its receiver, and its heading by
    its inertial unit, unless this sensor has realism of its own.
    """

    def __init__(self, name: str, context: SensorContext, conf: GoalConf) -> None:
        self._name, self._farthest_m = name, context.diagonal_m
        self._navigation = context.navigation if conf.realism is None else None
        self._reading: Floats = np.zeros((context.num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Distances up to the farthest, and whole turns."""
        low, high = [0.0, -PI32], [self._farthest_m, PI32]
        return {self._name: (np.array(low, np.float32), np.array(high, np.float32))}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present goal."""
        distance, bearing = now.goal.distance, now.goal.bearing
        if self._navigation is not None:
            offset = now.goal.position_w - self._navigation.receiver_position()
            distance = np.hypot(offset[:, 0], offset[:, 1])
            bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - self._navigation.heading)
        reading = np.empty((len(distance), 2), np.float32)
        reading[:, 0] = np.minimum(distance, self._farthest_m)
        reading[:, 1] = bearing
        self._reading = reading

    def read(self) -> dict[str, Reading]:
        """The latest distance and bearing."""
        return {self._name: self._reading.copy()}
