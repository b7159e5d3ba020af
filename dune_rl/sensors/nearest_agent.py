"""The nearest-agent sensor: where the nearest agent of other groups is, and how it moves."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensed_agents import sense_agents
from dune_rl.sensors.sensor import MAX_SENSED_SPEED_MPS, PI32, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.sensors.velocity import heading_frame
from dune_rl.state.state import GroupState, State


class NearestAgentConf(SensorSettings):
    """Which groups are looked at; none named: all groups but the sensor's own.

    Where the sensor's own group is named, each agent looks at the other agents of it.
    """

    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.05))

    sensor: Literal["nearest_agent"] = "nearest_agent"
    groups: tuple[str, ...] = Field((), description="groups that are looked at; none: all but its own")


class NearestAgent(VectorSensor):
    """The reading `name`, (N, 4): distance [m], bearing [rad] and relative velocity (2) of the nearest agent.

    Distance is horizontal, from origin to origin, at most the diagonal of the extent. The bearing is measured
    from the own heading, in [-pi, pi). The velocity is the other's minus the own [m/s], forward
    and left in the frame of the own heading, each component at most 10 m/s more than the body's top speed.
    Without another agent the reading is (the diagonal, 0, 0, 0).
    """

    def __init__(self, name: str, context: SensorContext, conf: NearestAgentConf) -> None:
        self._groups = conf.groups
        self._farthest_m = far = context.diagonal_m
        self._max_closing_mps = fast = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
        low, high = [0.0, -PI32, -fast, -fast], [far, PI32, fast, fast]
        super().__init__(name, context.num_rows, np.array(low, np.float32), np.array(high, np.float32))

    def measure(self, now: GroupState, state: State) -> None:
        """Find the nearest agent of each row and read its motion."""
        reading = np.zeros((len(self._reading), 4), np.float32)
        names = self._groups or tuple(name for name in state.groups if name != now.name)
        others = sense_agents(names, now, state)
        position, velocity, present = others.position_w, others.velocity_w, others.present
        if position.shape[1] == 0:
            reading[:, 0] = self._farthest_m
            self._reading = reading
            return
        offset = position - now.motion.position_w[:, None, :2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        nearest = np.where(present, distance, np.inf).argmin(axis=1)
        rows = np.arange(len(nearest))
        offset, yaw = offset[rows, nearest], now.motion.yaw
        reading[:, 0] = np.minimum(distance[rows, nearest], self._farthest_m)
        reading[:, 1] = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - yaw)
        closing = heading_frame(velocity[rows, nearest] - now.motion.velocity_w[:, :2], yaw)
        reading[:, 2:] = clip(closing, -self._max_closing_mps, self._max_closing_mps)
        reading[~present.any(axis=1)] = self._farthest_m, 0.0, 0.0, 0.0
        self._reading = reading
