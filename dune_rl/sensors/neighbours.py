"""Sensors of other agents: the nearest one of other groups, and a list of the nearest of all groups."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.navigation import KnownPose
from dune_rl.sensors.own_motion import heading_frame
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensor import MAX_SENSED_SPEED_MPS, PI32, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# Of each neighbour, without and with the goals of robots.
_VALUES, _VALUES_WITH_GOAL = 7, 9


@dataclass(frozen=True)
class SensedAgents:
    """The A agents of the groups that are looked at, for each of N rows.

    `position_w` and `velocity_w` are (N, A, 2) [m, m/s]; `present` (N, A) is False for the looking agent
    itself, and for agents that are not in the scene. `radius_m` and `is_robot` are (A,), `goal_w` (N, A, 2)
    [m] where goals are asked for.
    """

    position_w: Array
    velocity_w: Array
    present: Flags
    radius_m: Array
    is_robot: Flags
    goal_w: Array


def sense_agents(
    names: Sequence[str], observer: GroupState, state: State, *, goals: bool = False
) -> SensedAgents:
    """The agents of the groups `names` in the scene of each agent of the group `observer`."""
    rows = len(observer.motion.position_w)
    none, nobody = np.zeros((rows, 0, 2)), np.zeros(0)
    parts = [(none, none, none[..., 0].astype(bool), nobody, nobody.astype(bool), none)]
    for name in names:
        other, is_own = state.groups[name], name == observer.name
        if is_own and other.count == 1:
            # Nobody but the one agent of a scene that looks.
            continue
        is_itself = np.eye(other.count, dtype=bool) if is_own else np.zeros((1, other.count), bool)
        there = np.tile(~is_itself, (rows // len(is_itself), 1))
        if other.absent is not None:
            there &= ~np.repeat(other.by_scene(other.absent), observer.count, axis=0)
        position = _for_each(other.motion.position_w, other, observer)
        velocity = _for_each(other.motion.velocity_w, other, observer)
        goal = _for_each(other.goal.position_w, other, observer) if goals else none
        radius = np.full(other.count, other.body.radius_m)
        is_robot = np.full(other.count, other.body.is_robot)
        parts.append((position, velocity, there, radius, is_robot, goal))
    joined = (np.concatenate(each, axis=min(1, each[0].ndim - 1)) for each in zip(*parts, strict=True))
    return SensedAgents(*joined)


def _for_each(values: Array, other: GroupState, observer: GroupState) -> Array:
    """The values (M G, 2 or more) of a group in plan view, for each agent of `observer`: (N, G, 2)."""
    return np.repeat(other.by_scene(values[:, :2]), observer.count, axis=0)


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
    Without another agent the reading is (the diagonal, 0, 0, 0). A robot that navigates by faulty instruments
    is told where others are, and knows where it is by its receiver, its heading by its inertial unit.
    """

    def __init__(self, name: str, context: SensorContext, conf: NearestAgentConf) -> None:
        self._groups = conf.groups
        self._farthest_m = far = context.diagonal_m
        fast = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
        super().__init__(name, context.num_rows, [0.0, -PI32, -fast, -fast], [far, PI32, fast, fast])
        self._navigation = context.navigation

    def measure(self, now: GroupState, state: State) -> None:
        reading = np.zeros((len(self._reading), 4), np.float32)
        names = self._groups or tuple(name for name in state.groups if name != now.name)
        others = sense_agents(names, now, state)
        position, velocity, present = others.position_w, others.velocity_w, others.present
        if position.shape[1] == 0:
            reading[:, 0] = self._farthest_m
            self._reading = reading
            return
        own = KnownPose.of(self._navigation, now)
        offset = position - own.position_w[:, None, :2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        nearest = np.where(present, distance, np.inf).argmin(axis=1)
        rows = np.arange(len(nearest))
        offset = offset[rows, nearest]
        reading[:, 0] = distance[rows, nearest]
        reading[:, 1] = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - own.yaw)
        reading[:, 2:] = heading_frame(velocity[rows, nearest] - own.velocity_w[:, :2], own.yaw)
        reading[~present.any(axis=1)] = self._farthest_m, 0.0, 0.0, 0.0
        self._store(reading)


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
    What a robot knows of itself is as for `NearestAgent`.
    """

    def __init__(self, name: str, context: SensorContext, conf: NeighboursConf) -> None:
        self._conf = conf
        fast = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
        self._values = _VALUES_WITH_GOAL if conf.goals else _VALUES
        far = conf.range_m
        goal = [far] * (self._values - _VALUES)
        low = np.tile([0.0, -far, -far, -fast, -fast, 0.0, 0.0, *np.negative(goal)], conf.number)
        high = np.tile([1.0, far, far, fast, fast, far, 1.0, *goal], conf.number)
        super().__init__(name, context.num_rows, low, high)
        self._navigation = context.navigation

    def measure(self, now: GroupState, state: State) -> None:
        names = self._conf.groups or tuple(state.groups)
        others = sense_agents(names, now, state, goals=self._conf.goals)
        number = min(self._conf.number, others.present.shape[1])
        reading = np.zeros((len(self._reading), self._conf.number, self._values))
        own = KnownPose.of(self._navigation, now)
        place = own.position_w[:, None, :2]
        offset = others.position_w - place
        distance = np.where(others.present, np.hypot(offset[..., 0], offset[..., 1]), np.inf)
        # Stable: equally far agents are listed in the order of their groups on every machine.
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :number]
        seen = np.take_along_axis(distance, nearest, axis=1) <= self._conf.range_m
        closing = others.velocity_w - own.velocity_w[:, None, :2]
        cos, sin = np.cos(own.yaw)[:, None], np.sin(own.yaw)[:, None]
        listed = [(1, offset), (3, closing)]
        if self._conf.goals:
            listed.append((_VALUES, np.where(others.is_robot[:, None], others.goal_w - place, 0.0)))
        for first, vectors in listed:
            x, y = (np.take_along_axis(vectors[..., axis], nearest, axis=1) for axis in (0, 1))
            reading[:, :number, first] = cos * x + sin * y
            reading[:, :number, first + 1] = cos * y - sin * x
        reading[:, :number, 0] = 1.0
        reading[:, :number, 5] = others.radius_m[nearest]
        reading[:, :number, 6] = others.is_robot[nearest]
        reading[:, :number] *= seen[..., None]
        self._store(reading.reshape(len(reading), -1))
