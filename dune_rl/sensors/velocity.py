"""Velocity sensors: forward speed and yaw rate of a robot, and the planar velocity of any body."""

import numpy as np

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.state.state import GroupState, State

MAX_SENSED_SPEED_MPS = 10.0
MAX_SENSED_TURN_RADPS = 34.9
_HIGHEST = np.array([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS], np.float32)
_LOWEST = -_HIGHEST
# A body may exceed its top speed by this share, by rounding.
_SPEED_MARGIN = 1.01


class Velocity:
    """The reading `name`, (N, 2): forward speed [m/s] and yaw rate [rad/s] in the body frame, clipped."""

    def __init__(self, num_rows: int, name: str = "velocity") -> None:
        self._name = name
        self._reading: Floats = np.zeros((num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Symmetric: 10 m/s and 34.9 rad/s."""
        return {self._name: (-_HIGHEST, _HIGHEST)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present motion."""
        values = np.empty((len(self._reading), 2), np.float32)
        values[:, 0] = now.motion.velocity_b[:, 0]
        values[:, 1] = now.motion.angular_b[:, 2]
        np.maximum(values, _LOWEST, out=values)
        self._reading = np.minimum(values, _HIGHEST, out=values)

    def read(self) -> dict[str, Reading]:
        """The latest motion."""
        return {self._name: self._reading.copy()}


class PlanarVelocity:
    """The reading `name`, (N, 2): horizontal velocity [m/s] along the heading and to its left.

    Bounds follow from `max_speed_mps`, the top speed of the body; readings are clipped to them.
    """

    def __init__(self, num_rows: int, max_speed_mps: float, name: str = "planar_velocity") -> None:
        self._name = name
        self._highest = np.full(2, max_speed_mps * _SPEED_MARGIN, np.float32)
        self._reading: Floats = np.zeros((num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Symmetric: the top speed and one percent."""
        return {self._name: (-self._highest, self._highest)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read the present motion."""
        values = heading_frame(now.motion.velocity_w, now.motion.yaw).astype(np.float32)
        self._reading = np.minimum(np.maximum(values, -self._highest), self._highest)

    def read(self) -> dict[str, Reading]:
        """The latest motion."""
        return {self._name: self._reading.copy()}


def heading_frame(vector_w: Array, yaw: Array) -> Array:
    """Components (N, 2) along headings `yaw` (N,) [rad] and to their left, of world vectors (N, 2 or 3)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vector_w[:, 0], vector_w[:, 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
