"""Noise, biases and steps of single quantities, and the drift of an integrated heading."""

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.sensors.draws import Rows, draw, normal
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.state.state import GroupState

# Highest Allan deviation of a first-order Gauss-Markov process over its own deviation, at 1.89
# correlation times: IEEE Std 952-1997, annex C.
_GAUSS_MARKOV_PEAK = 0.6174


_GYROSCOPE, _ROLL, _PITCH, _YAW = slice(3, 6), 6, 7, 8
# The yaw rate follows from body rates over the cosine of the pitch: held away from nose up and nose down.
_LEAST_COSINE = 0.1


class NoiseConf(Settings):
    """Faults of one quantity, in its own unit (called u here); all are deviations, and 0 is none.

    The floor of the Allan deviation, `bias_instability`, is given by a bias that wanders.
    """

    wraps: ClassVar[bool] = False

    noise_density: float = Field(0.0, ge=0.0, description="white noise N, whatever the rate [u/√Hz]")
    noise: float = Field(0.0, ge=0.0, description="standard deviation of white noise of each reading [u]")
    bias: float = Field(0.0, ge=0.0, description="standard deviation of a bias constant over an episode [u]")
    bias_instability: float = Field(0.0, ge=0.0, description="floor of the Allan deviation [u]")
    bias_correlation_s: float = Field(100.0, gt=0.0, description="correlation time of the wandering bias [s]")
    bias_walk: float = Field(0.0, ge=0.0, description="random walk K of a bias that starts at 0 [u/s/√Hz]")
    quantum: float = Field(0.0, ge=0.0, description="step between two values [u]")


class AngleNoiseConf(NoiseConf):
    """Faults of an angle [rad], which goes on at -pi where it passes pi."""

    wraps: ClassVar[bool] = True


class Faults:
    """Noise, biases and steps of the reading `name` within `bounds`, read every `period_s` of N agents.

    White noise of density N has the deviation N/√period; a random walk K grows by a normal number of
    K√period; a Gauss-Markov bias keeps exp(-period/correlation) of itself (IEEE Std 952-1997, annex C).
    """

    def __init__(
        self, name: str, bounds: Bounds, channels: tuple[NoiseConf, ...], num_rows: int, period_s: float
    ) -> None:
        low, high = bounds
        if len(channels) != low.size:
            raise ValueError(f"{name} has {low.size} entries, and {len(channels)} have faults")
        self._name, self._entries = name, low.size
        self._low, self._high = low.reshape(-1).astype(np.float64), high.reshape(-1).astype(np.float64)
        self._type = low.dtype

        def each(field: str) -> Array:
            return np.array([getattr(conf, field) for conf in channels])

        self._noise = np.hypot(each("noise_density") / np.sqrt(period_s), each("noise"))
        self._bias_size = each("bias")
        self._walk = each("bias_walk") * np.sqrt(period_s)
        self._kept = np.exp(-period_s / each("bias_correlation_s"))
        self._wander_size = each("bias_instability") / _GAUSS_MARKOV_PEAK
        self._stirred = self._wander_size * np.sqrt(1.0 - self._kept**2)
        quantum = each("quantum")
        self._stepped = np.flatnonzero(quantum)
        self._quantum = quantum[self._stepped]
        faulty = self._noise + self._bias_size + self._walk + self._wander_size + quantum > 0.0
        # What has no fault keeps its bytes, which to wrap would round.
        self._turning = np.flatnonzero(faulty & np.array([conf.wraps for conf in channels]))
        self._drifts = bool(self._walk.any() or self._wander_size.any())
        self._bias = np.zeros((num_rows, self._entries))
        self._wander = np.zeros((num_rows, self._entries))

    def begin(self, rows: Rows, now: GroupState) -> None:
        """Draw the biases of the episodes in `rows`."""
        drawn = draw(normal, now.episode, f"{self._name} bias", 2 * self._entries, rows, once=True)
        self._bias[rows] = drawn[:, : self._entries] * self._bias_size
        self._wander[rows] = drawn[:, self._entries :] * self._wander_size

    def advance(self, rows: Rows, now: GroupState) -> None:
        """Let the biases drift for a period."""
        if not self._drifts:
            return
        entries = self._entries
        drawn = draw(normal, now.episode, f"{self._name} drift", 2 * entries, rows)
        self._bias[rows] += drawn[:, :entries] * self._walk
        self._wander[rows] = self._wander[rows] * self._kept + drawn[:, entries:] * self._stirred

    def applied(self, reading: Reading, rows: Rows, now: GroupState) -> Reading:
        """What the instruments in `rows` make of their true `reading` (len(rows), ...)."""
        return self.limited(self.noisy(reading, rows, now)).reshape(reading.shape)

    def noisy(self, reading: Reading, rows: Rows, now: GroupState) -> Array:
        """The true `reading` with biases and noise, (len(rows), entries), before steps between values."""
        value: Array = reading.reshape(len(reading), -1) + (self._bias[rows] + self._wander[rows])
        if self._noise.any():
            value += draw(normal, now.episode, f"{self._name} noise", self._entries, rows) * self._noise
        return value

    def limited(self, value: Array) -> Reading:
        """`value` (n, entries), which changes, on its steps and within its bounds, in the reading's type."""
        if len(self._stepped):
            value[:, self._stepped] = np.rint(value[:, self._stepped] / self._quantum) * self._quantum
        if len(self._turning):
            value[:, self._turning] = wrap_angle(value[:, self._turning])
        if np.issubdtype(self._type, np.integer):
            np.rint(value, out=value)
        limited: Reading = clip(value, self._low, self._high).astype(self._type)
        return limited


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
        roll, pitch = reading[:, _ROLL].astype(np.float64), reading[:, _PITCH].astype(np.float64)
        _, y, z = (value[:, _GYROSCOPE] - reading[:, _GYROSCOPE]).T
        cosine = np.cos(pitch)
        cosine = np.copysign(np.maximum(np.abs(cosine), _LEAST_COSINE), cosine)
        turned = (y * np.sin(roll) + z * np.cos(roll)) / cosine * self._period_s
        self._drift[rows] += np.where(now.episode.steps[rows] > 0, turned, 0.0)
        drift = self._drift[rows]
        # To wrap rounds: what does not drift keeps its bytes.
        value[:, _YAW] = np.where(drift != 0.0, wrap_angle(value[:, _YAW] + drift), value[:, _YAW])
        return self.limited(value)
