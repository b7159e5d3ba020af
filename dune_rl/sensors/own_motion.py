"""What an agent senses of its own motion: velocity, position in the world, and its goal."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.draws import draw, normal
from dune_rl.sensors.navigation import Navigation
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import (
    GoalRealismConf,
    PositionRealismConf,
    SpeedRealismConf,
)
from dune_rl.sensors.sensor import MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS, PI32, Sensor, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, Motion, State

# An error beyond this many standard deviations, one reading in 16,000, is clipped at the world's edge.
_FARTHEST_DRIFT = 4.0
_HIGHEST = np.array([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS])
# A body may exceed its top speed by this share, by rounding.
_SPEED_MARGIN = 1.01
_ODOMETRY_SPEED = 3
# What a body without wheels knows of its speed, by the motion of its legs; an estimate.
LEG_SPEED = SpeedRealismConf(forward=NoiseConf(noise=0.05, bias=0.02))


class VelocityConf(SensorSettings):
    """A velocity has nothing to set beside its realism."""

    sensor: Literal["velocity"] = "velocity"
    realism: SpeedRealismConf | None = None


class PlanarVelocityConf(SensorSettings):
    """A planar velocity has nothing to set beside its realism."""

    sensor: Literal["planar_velocity"] = "planar_velocity"


class Velocity(VectorSensor):
    """The reading `name`, (N, 2): forward speed [m/s] and yaw rate [rad/s] in the body frame, clipped."""

    def __init__(self, name: str, context: SensorContext, conf: VelocityConf) -> None:
        super().__init__(name, context.num_rows, -_HIGHEST, _HIGHEST)

    def measure(self, now: GroupState, state: State) -> None:
        self._store(np.stack([now.motion.velocity_b[:, 0], now.motion.angular_b[:, 2]], axis=1))


class EstimatedVelocity(VectorSensor):
    """The reading "velocity", (N, 2): speed by `speed` [m/s] and yaw rate by the inertial unit [rad/s].

    `speed` is wheel odometry, or a velocity sensor on a body without wheels. Neither is read here: they must
    have been read before.
    """

    def __init__(self, speed: Sensor, imu: Sensor, num_rows: int) -> None:
        super().__init__("velocity", num_rows, -_HIGHEST, _HIGHEST)
        self._speed, self._imu = speed, imu

    def measure(self, now: GroupState, state: State) -> None:
        speed = self._speed.read()
        ahead = speed["odometry"][:, _ODOMETRY_SPEED] if "odometry" in speed else speed["velocity"][:, 0]
        self._store(np.stack([ahead, self._imu.read()["imu"][:, 5]], axis=1))


class PlanarVelocity(VectorSensor):
    """The reading `name`, (N, 2): horizontal velocity [m/s] along the heading and to its left.

    Bounds follow from the top speed of the body; readings are clipped to them. A robot that navigates by
    faulty instruments knows its speed ahead, and takes that to the left for 0.
    """

    def __init__(self, name: str, context: SensorContext, conf: PlanarVelocityConf) -> None:
        highest = np.full(2, context.carrier.max_speed_mps * _SPEED_MARGIN)
        super().__init__(name, context.num_rows, -highest, highest)
        self._navigation = context.navigation

    def measure(self, now: GroupState, state: State) -> None:
        known: Motion | Navigation = now.motion if self._navigation is None else self._navigation
        self._store(heading_frame(known.velocity_w, known.yaw))


def heading_frame(vector_w: Array, yaw: Array) -> Array:
    """Components (N, 2) along headings `yaw` (N,) [rad] and to their left, of world vectors (N, 2 or 3)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vector_w[:, 0], vector_w[:, 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


class PositionConf(SensorSettings):
    """A slow error of the position, as satellites' orbits and the air make it; without one it is the true.

    The drifts are standard deviations, of x and y each and of z. An error fades to a share of 1/e of itself
    in `drift_time_s`, and new ones take its place (a Gauss-Markov process of first order).
    """

    default_realism: ClassVar = PositionRealismConf.model_validate("zed_f9p")

    sensor: Literal["position"] = "position"
    realism: PositionRealismConf | None = None
    drift_horizontal_m: float = Field(0.0, ge=0.0, le=1_000.0, description="deviation of x and of y [m]")
    drift_vertical_m: float = Field(0.0, ge=0.0, le=1_000.0, description="deviation of z [m]")
    drift_time_s: float = Field(60.0, gt=0.0, le=1e5, description="time in which an error fades to 1/e [s]")


class Position(VectorSensor):
    """The reading `name`, (N, 4): x, y, z of the body's origin [m] and yaw [rad] in the world frame.

    Readings are clipped to the extent and heights of the world, and to what the drift adds.
    """

    def __init__(self, name: str, context: SensorContext, conf: PositionConf) -> None:
        extent, heights, step_s = context.extent, context.heights, context.step_s
        xmin, xmax, ymin, ymax = extent
        low, high = np.array([xmin, ymin, heights[0]]), np.array([xmax, ymax, heights[1]])
        # Written so that NaN, which compares false, is refused.
        if not ((low <= high).all() and np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError(
                f"extent {extent} and heights {heights} need a finite lowest value, then the highest: "
                "(xmin, xmax, ymin, ymax) and (zmin, zmax)"
            )
        self._drift_name = f"{name}_drift"
        self._spread = np.array([conf.drift_horizontal_m, conf.drift_horizontal_m, conf.drift_vertical_m])
        self._drifts = bool(self._spread.any())
        self._kept = float(np.exp(-step_s / conf.drift_time_s))
        # What is new each step keeps the spread as it is.
        self._renewed = float(np.sqrt(-np.expm1(-2 * step_s / conf.drift_time_s)))
        self._drift = np.zeros((context.num_rows, 3))
        reach = _FARTHEST_DRIFT * self._spread
        super().__init__(name, context.num_rows, [*(low - reach), -PI32], [*(high + reach), PI32])

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Start the episodes of the agents in `mask` (N,) with an error of their own."""
        if self._drifts:
            self._drift = np.where(
                mask[:, None], self._spread * draw(normal, now.episode, self._drift_name, 3), self._drift
            )
        self._take(now)

    def measure(self, now: GroupState, state: State) -> None:
        if self._drifts:
            self._drift = self._kept * self._drift + self._renewed * self._spread * draw(
                normal, now.episode, self._drift_name, 3
            )
        self._take(now)

    def _take(self, now: GroupState) -> None:
        position_w = now.motion.position_w + self._drift
        self._store(np.concatenate([position_w, now.motion.roll_pitch_yaw[:, 2:]], axis=1))


class GoalDirectionConf(SensorSettings):
    """Direction of the goal and bounded distances, which tell near goals apart and far ones not."""

    sensor: Literal["goal_direction"] = "goal_direction"
    realism: None = Field(None, description="none of its own: that of the sensor goal")
    far_m: float = Field(7.0, gt=0.0, le=1000.0, description="distance at which the first share is 1 [m]")
    near_m: float = Field(1.5, gt=0.0, le=1000.0, description="distance at which the second share is 1 [m]")

    @model_validator(mode="after")
    def _far_is_farther(self) -> Self:
        if self.far_m <= self.near_m:
            raise ValueError(f"far_m ({self.far_m:g}) must be above near_m ({self.near_m:g})")
        return self


class GoalDirection(VectorSensor):
    """The reading `name`, (N, 4): cosine and sine of the goal's bearing, and its distance as two shares.

    The shares are of `far_m` and of `near_m`, at most 1.
    """

    def __init__(self, name: str, context: SensorContext, conf: GoalDirectionConf) -> None:
        super().__init__(name, context.num_rows, [-1.0, -1.0, 0.0, 0.0], np.ones(4))
        self._goal, self._conf = context.reading_of("goal"), conf

    def measure(self, now: GroupState, state: State) -> None:
        distance, bearing = self._goal().T
        shares = distance / self._conf.far_m, distance / self._conf.near_m
        self._store(np.stack([np.cos(bearing), np.sin(bearing), *shares], axis=1))


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
        super().__init__(name, context.num_rows, [0.0, -PI32], [context.diagonal_m, PI32])
        self._navigation = context.navigation

    def measure(self, now: GroupState, state: State) -> None:
        distance, bearing = now.goal.distance, now.goal.bearing
        if self._navigation is not None:
            offset = now.goal.position_w - self._navigation.receiver_position()[:, :2]
            distance = np.hypot(offset[:, 0], offset[:, 1])
            bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - self._navigation.yaw)
        self._store(np.stack([distance, bearing], axis=1))
