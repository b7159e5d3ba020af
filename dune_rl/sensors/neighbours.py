"""The neighbours sensor: a list of the nearest other agents, of all groups."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.frames import clip
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensed_agents import sense_agents, sense_goals
from dune_rl.sensors.sensor import MAX_SENSED_SPEED_MPS, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# Of each neighbour, without and with the goals of robots.
_VALUES, _VALUES_WITH_GOAL = 7, 9


class NeighboursConf(SensorSettings):
    """How many agents are listed, and which groups are looked at; none named: all, the own one included.

    `goals` adds the goal position of each robot.
    """

    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.05))

    sensor: Literal["neighbours"] = "neighbours"
    number: int = Field(4, ge=1, le=64, description="agents listed, the nearest first")
    range_m: float = Field(10.0, gt=0.0, le=1_000.0, description="who is farther is not listed [m]")
    groups: tuple[str, ...] = Field((), description="groups that are looked at; none: all, its own too")
    goals: bool = Field(False, description="whether it has the goals of robots, too")


class Neighbours(VectorSensor):
    """The reading `name`, of the k nearest other agents within `range_m`, the nearest first.

    It is (N, 7 k), or (N, 9 k) with `goals`. Of each agent it has 1 for present, the place forward and to the
    left of the own origin [m], the velocity relative to the own, forward and left [m/s], each component at
    most 10 m/s more than the body's top speed, the radius in plan view [m], and 1 for a robot. With `goals`
    there follows the place of a robot's goal, forward and left [m], 0 for other agents; each component is at
    most `range_m` either way, which bends the direction to goals farther away. Directions are in the frame of
    the own heading, distances horizontal, from origin to origin. Where there are fewer agents, the rest is 0.
    """

    def __init__(self, name: str, context: SensorContext, conf: NeighboursConf) -> None:
        self._conf = conf
        self._max_closing_mps = fast = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
        self._values = _VALUES_WITH_GOAL if conf.goals else _VALUES
        far = conf.range_m
        goal = [far] * (self._values - _VALUES)
        low = np.tile([0.0, -far, -far, -fast, -fast, 0.0, 0.0, *np.negative(goal)], conf.number)
        high = np.tile([1.0, far, far, fast, fast, far, 1.0, *goal], conf.number)
        super().__init__(name, context.num_rows, low.astype(np.float32), high.astype(np.float32))

    def measure(self, now: GroupState, state: State) -> None:
        """List the agents of each row."""
        names = self._conf.groups or tuple(state.groups)
        others = sense_agents(names, now, state)
        number = min(self._conf.number, others.present.shape[1])
        reading = np.zeros((len(self._reading), self._conf.number, self._values))
        own = now.motion.position_w[:, None, :2]
        offset = others.position_w - own
        distance = np.where(others.present, np.hypot(offset[..., 0], offset[..., 1]), np.inf)
        # Stable: equally far agents are listed in the order of their groups on every machine.
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :number]
        seen = np.take_along_axis(distance, nearest, axis=1) <= self._conf.range_m
        closing = others.velocity_w - now.motion.velocity_w[:, None, :2]
        cos, sin = np.cos(now.motion.yaw)[:, None], np.sin(now.motion.yaw)[:, None]
        far = self._conf.range_m
        listed = [(1, offset, far), (3, closing, self._max_closing_mps)]
        if self._conf.goals:
            to_goal = np.where(others.is_robot[:, None], sense_goals(names, now, state) - own, 0.0)
            listed.append((_VALUES, to_goal, far))
        for first, vectors, limit in listed:
            x, y = (np.take_along_axis(vectors[..., axis], nearest, axis=1) for axis in (0, 1))
            reading[:, :number, first] = clip(cos * x + sin * y, -limit, limit)
            reading[:, :number, first + 1] = clip(cos * y - sin * x, -limit, limit)
        reading[:, :number, 0] = 1.0
        reading[:, :number, 5] = np.minimum(others.radius_m, self._conf.range_m)[nearest]
        reading[:, :number, 6] = others.is_robot[nearest]
        reading[:, :number] *= seen[..., None]
        self._reading = reading.reshape(len(reading), -1).astype(np.float32)
