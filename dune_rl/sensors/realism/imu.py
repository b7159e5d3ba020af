"""Faults of an inertial unit whose heading is integrated from its gyroscope."""

from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.realism.noise import Faults, Rows
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState

_GYROSCOPE, _ROLL, _PITCH, _YAW = slice(3, 6), 6, 7, 8
# The yaw rate follows from body rates over the cosine of the pitch: held away from nose up and nose down.
_LEAST_COSINE = 0.1


class ImuFaults(Faults):
    """Faults of a reading "imu" in which the errors of the yaw rate add up to a drift of the yaw.

    The drift is that of an integrator that begins with the episode. Of white noise N, a constant bias b and a
    random walk K it has after a time t the variance N² t + b² t² + K² t³ / 3. Where the unit tilts, the error
    of the yaw rate is (e_y sin(roll) + e_z cos(roll)) / cos(pitch), of errors e of the body rates.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._period_s: float = args[-1]
        self._drift = np.zeros(len(self._bias))

    def begin(self, rows: Rows, now: GroupState) -> None:
        """Draw the biases of the episodes in `rows`, which begin without drift."""
        super().begin(rows, now)
        self._drift[rows] = 0.0

    def applied(self, reading: Reading, rows: Rows, now: GroupState) -> Reading:
        """What the units in `rows` make of their true `reading` (len(rows), 9)."""
        value = self.noisy(reading, rows, now)
        turned = self._yaw_rate_error(reading, value[:, _GYROSCOPE] - reading[:, _GYROSCOPE]) * self._period_s
        self._drift[rows] += np.where(now.episode.steps[rows] > 0, turned, 0.0)
        drift = self._drift[rows]
        # To wrap rounds: what does not drift keeps its bytes.
        value[:, _YAW] = np.where(drift != 0.0, wrap_angle(value[:, _YAW] + drift), value[:, _YAW])
        return self.limited(value)

    @staticmethod
    def _yaw_rate_error(reading: Reading, errors: Array) -> Array:
        roll, pitch = reading[:, _ROLL].astype(np.float64), reading[:, _PITCH].astype(np.float64)
        _, y, z = errors.T
        cosine = np.cos(pitch)
        cosine = np.copysign(np.maximum(np.abs(cosine), _LEAST_COSINE), cosine)
        rate: Array = (y * np.sin(roll) + z * np.cos(roll)) / cosine
        return rate
