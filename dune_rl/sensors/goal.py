"""The goal sensor: distance and bearing of an agent's goal."""

from typing import Literal

import numpy as np

from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.pipeline import GoalRealismConf
from dune_rl.sensors.sensor import PI32, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class GoalConf(SensorSettings):
    """A goal has nothing to set beside its realism."""

    sensor: Literal["goal"] = "goal"
    realism: GoalRealismConf | None = None


class Goal(VectorSensor):
    """The reading `name`, (N, 2): horizontal distance [m], at most the extent's diagonal, and bearing [rad].

    The bearing is measured from the agent's heading, counter-clockwise, in [-pi, pi). A robot that navigates
    by faulty instruments knows the goal's coordinates, its own position by its receiver, and its heading by
    its inertial unit, unless this sensor has realism of its own.
    """

    def __init__(self, name: str, context: SensorContext, conf: GoalConf) -> None:
        self._farthest_m = context.diagonal_m
        low, high = [0.0, -PI32], [self._farthest_m, PI32]
        super().__init__(name, context.num_rows, np.array(low, np.float32), np.array(high, np.float32))
        self._navigation = context.navigation if conf.realism is None else None

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
