"""Velocity sensors: forward speed and yaw rate of a robot, and the planar velocity of any body."""

from typing import ClassVar, Literal

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf, SpeedRealismConf
from dune_rl.sensors.sensor import MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS, Sensor, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

_HIGHEST = np.array([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS], np.float32)
_LOWEST = -_HIGHEST
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

    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.05))

    sensor: Literal["planar_velocity"] = "planar_velocity"


class Velocity(VectorSensor):
    """The reading `name`, (N, 2): forward speed [m/s] and yaw rate [rad/s] in the body frame, clipped."""

    def __init__(self, name: str, context: SensorContext, conf: VelocityConf) -> None:
        super().__init__(name, context.num_rows, _LOWEST, _HIGHEST)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present motion."""
        values = np.empty((len(self._reading), 2), np.float32)
        values[:, 0] = now.motion.velocity_b[:, 0]
        values[:, 1] = now.motion.angular_b[:, 2]
        np.maximum(values, _LOWEST, out=values)
        self._reading = np.minimum(values, _HIGHEST, out=values)


class EstimatedVelocity(VectorSensor):
    """The reading "velocity", (N, 2): speed by `speed` [m/s] and yaw rate by the inertial unit [rad/s].

    `speed` is wheel odometry, or a velocity sensor on a body without wheels. Neither is read here: they must
    have been read before.
    """

    def __init__(self, speed: Sensor, imu: Sensor, num_rows: int) -> None:
        super().__init__("velocity", num_rows, _LOWEST, _HIGHEST)
        self._speed, self._imu = speed, imu

    def measure(self, now: GroupState, state: State) -> None:
        """Take both from the latest readings."""
        speed = self._speed.read()
        ahead = speed["odometry"][:, _ODOMETRY_SPEED] if "odometry" in speed else speed["velocity"][:, 0]
        reading = np.stack([ahead, self._imu.read()["imu"][:, 5]], axis=1)
        self._reading = np.minimum(np.maximum(reading, _LOWEST), _HIGHEST)


class PlanarVelocity(VectorSensor):
    """The reading `name`, (N, 2): horizontal velocity [m/s] along the heading and to its left.

    Bounds follow from the top speed of the body; readings are clipped to them.
    """

    def __init__(self, name: str, context: SensorContext, conf: PlanarVelocityConf) -> None:
        highest = np.full(2, context.carrier.max_speed_mps * _SPEED_MARGIN, np.float32)
        super().__init__(name, context.num_rows, -highest, highest)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present motion."""
        values = heading_frame(now.motion.velocity_w, now.motion.yaw).astype(np.float32)
        self._reading = np.minimum(np.maximum(values, self._low), self._high)


def heading_frame(vector_w: Array, yaw: Array) -> Array:
    """Components (N, 2) along headings `yaw` (N,) [rad] and to their left, of world vectors (N, 2 or 3)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vector_w[:, 0], vector_w[:, 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
