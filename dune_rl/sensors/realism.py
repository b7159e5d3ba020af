"""What real instruments add to the truth: rate, latency, noise, drifting biases and steps between values."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.frames import within, wrap_angle
from dune_rl.sensors.draws import normal
from dune_rl.sensors.presets import Kind, preset
from dune_rl.sensors.sensor import Bounds, Counts, Flags, Moment, Reading, Sensor
from dune_rl.settings import Settings

Array = NDArray[np.float64]
# Which scenes: their numbers, or all of them.
Rows = NDArray[np.int64] | slice

# Highest Allan deviation of a first-order Gauss-Markov process over its own deviation, at 1.89
# correlation times: IEEE Std 952-1997, annex C.
_GAUSS_MARKOV_PEAK = 0.6174


class NoiseConf(Settings):
    """Faults of one quantity, in its own unit (called u here); all are deviations, and 0 is none.

    `noise_density` [u/√Hz] is white noise N, whatever the rate; `noise` [u]
    is white noise of each reading. `bias` [u] is constant over an episode,
    `bias_instability` [u] is the floor of the Allan deviation that data
    sheets state, given by a bias that wanders with `bias_correlation_s`, and
    `bias_walk` [u/s/√Hz] is the random walk K that starts at 0 with an
    episode. `quantum` [u] is the step between two values.
    """

    wraps: ClassVar[bool] = False

    noise_density: float = Field(0.0, ge=0.0)
    noise: float = Field(0.0, ge=0.0)
    bias: float = Field(0.0, ge=0.0)
    bias_instability: float = Field(0.0, ge=0.0)
    bias_correlation_s: float = Field(100.0, gt=0.0)
    bias_walk: float = Field(0.0, ge=0.0)
    quantum: float = Field(0.0, ge=0.0)


class AngleNoiseConf(NoiseConf):
    """Faults of an angle [rad], which goes on at -pi where it passes pi."""

    wraps: ClassVar[bool] = True


class RealismConf(Settings):
    """Rate and latency of a sensor; classes derived from this add its own faults.

    Without `rate_hz` it reads each control step, with it at the beginning of
    an episode and from then on at that rate, which must divide the control
    rate. A reading arrives `latency_s` late, a whole number of control steps;
    until then the first reading of the episode is given.

    Classes for a `kind` of part take the name of one: alone ("bno055"), or as
    `preset` beside settings that differ.
    """

    kind: ClassVar[Kind | None] = None

    preset: str | None = None
    rate_hz: float | None = Field(None, gt=0.0, le=10_000.0)
    latency_s: float = Field(0.0, ge=0.0, le=2.0)

    @model_validator(mode="before")
    @classmethod
    def _of_part(cls, data: Any) -> Any:
        if isinstance(data, str):
            data = {"preset": data}
        if not isinstance(data, Mapping) or not isinstance(data.get("preset"), str):
            return data
        if cls.kind is None:
            raise ValueError(f"preset must be null (got {data['preset']!r}): no parts are known here")
        return _merged(preset(data["preset"], cls.kind).settings, data)

    def channels(self, size: int) -> tuple[NoiseConf, ...]:
        """Faults of each of the `size` entries of a reading; none at all for a sensor with its own."""
        return ()

    def steps(self, step_s: float) -> tuple[int, int]:
        """Control steps of `step_s` between two readings, and until a reading arrives; or ValueError."""
        every = 1 if self.rate_hz is None else self._every(1.0 / step_s, self.rate_hz)
        late = self.latency_s / step_s
        if abs(late - round(late)) > 1e-3:
            near = " or ".join(f"{steps * step_s:.4g}" for steps in (int(late), int(late) + 1))
            raise ValueError(
                f"latency_s={self.latency_s:g} is not a whole number of control steps of {step_s:g} s; "
                f"write {near}"
            )
        return every, round(late)

    @staticmethod
    def _every(control_hz: float, rate_hz: float) -> int:
        every = control_hz / rate_hz
        if every < 1.0 - 1e-3:
            raise ValueError(
                f"rate_hz={rate_hz:g} is above the control rate of {control_hz:g} Hz; "
                f"write {control_hz:g} or a whole fraction of it, or null for every control step"
            )
        if abs(every - round(every)) > 1e-3 * every:
            near = " or ".join(f"{control_hz / steps:.4g}" for steps in (int(every), int(every) + 1))
            raise ValueError(
                f"rate_hz={rate_hz:g} does not divide the control rate of {control_hz:g} Hz; write {near}"
            )
        return round(every)


class ImuRealismConf(RealismConf):
    """Faults of an inertial unit: `tilt` is of roll and pitch, `heading` of yaw."""

    kind = "imu"

    accelerometer: NoiseConf = NoiseConf()
    gyroscope: NoiseConf = NoiseConf()
    tilt: AngleNoiseConf = AngleNoiseConf()
    heading: AngleNoiseConf = AngleNoiseConf()

    def channels(self, size: int) -> tuple[NoiseConf, ...]:
        """Three axes of each, and three angles."""
        return (self.accelerometer,) * 3 + (self.gyroscope,) * 3 + (self.tilt,) * 2 + (self.heading,)


class SpeedRealismConf(RealismConf):
    """Faults of what a rover's own controller knows: `forward` [m/s] and `turn` [rad/s]."""

    forward: NoiseConf = NoiseConf()
    turn: NoiseConf = NoiseConf()

    def channels(self, size: int) -> tuple[NoiseConf, ...]:
        """One each."""
        return (self.forward, self.turn)


class Realism:
    """A sensor seen through the faults of `conf`; within its bounds and of its types.

    The stages follow one another as in an instrument: a reading is taken at
    the rate; biases and noise are added; it falls on a step between values
    and is held to the range; it arrives late, and is held until the next.
    What is random depends on the seed, the episode and its step alone.
    """

    def __init__(self, sensor: Sensor, conf: RealismConf, num_scenes: int, step_s: float) -> None:
        self._sensor = sensor
        self._every, delay = conf.steps(step_s)
        self._faults: dict[str, Faults] = {}
        self._ring: dict[str, Reading] = {}
        for name, bounds in sensor.bounds().items():
            low = bounds[0]
            self._ring[name] = np.zeros((delay + 1, num_scenes, *low.shape), low.dtype)
            channels = conf.channels(low.size)
            if channels:
                self._faults[name] = Faults(name, bounds, channels, num_scenes, self._every * step_s)
        self._slots, self._newest = delay + 1, 0

    def bounds(self) -> dict[str, Bounds]:
        """Those of the sensor within."""
        return self._sensor.bounds()

    def begin(self, mask: Flags, now: Moment) -> None:
        """Read, and forget what the scenes in `mask` (M,) have read before."""
        self._sensor.begin(mask, now)
        rows = np.flatnonzero(mask)
        for name, reading in self._sensor.read().items():
            fresh = reading[rows]
            if name in self._faults:
                self._faults[name].begin(rows, now)
                fresh = self._faults[name].applied(fresh, rows, now)
            self._ring[name][:, rows] = fresh

    def measure(self, now: Moment) -> None:
        """Read where a reading is due, and let the others stand."""
        self._sensor.measure(now)
        due = now.steps % self._every == 0
        rows: Rows = slice(None) if due.all() else np.flatnonzero(due)
        readings = self._sensor.read() if due.any() else {}
        before = self._newest
        self._newest = (before + 1) % self._slots
        for name, ring in self._ring.items():
            if not due.all():
                ring[self._newest] = ring[before]
            if name not in readings:
                continue
            fresh = readings[name][rows]
            if name in self._faults:
                self._faults[name].advance(rows, now)
                fresh = self._faults[name].applied(fresh, rows, now)
            ring[self._newest, rows] = fresh

    def read(self) -> dict[str, Reading]:
        """The readings that have arrived."""
        oldest = (self._newest + 1) % self._slots
        return {name: ring[oldest].copy() for name, ring in self._ring.items()}


class Faults:
    """Noise, biases and steps of the reading `name` within `bounds`, read every `period_s` in M scenes.

    White noise of density N has the deviation N/√period; a random walk K
    grows by a normal number of K√period; a Gauss-Markov bias keeps
    exp(-period/correlation) of itself (IEEE Std 952-1997, annex C).
    """

    def __init__(
        self, name: str, bounds: Bounds, channels: tuple[NoiseConf, ...], num_scenes: int, period_s: float
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
        self._bias = np.zeros((num_scenes, self._entries))
        self._wander = np.zeros((num_scenes, self._entries))

    def begin(self, rows: Rows, now: Moment) -> None:
        """Draw the biases of the episodes in `rows`."""
        never: Counts = np.zeros_like(now.steps[rows])
        drawn = normal(now.seed, f"{self._name} bias", now.episodes[rows], never, 2 * self._entries)
        self._bias[rows] = drawn[:, : self._entries] * self._bias_size
        self._wander[rows] = drawn[:, self._entries :] * self._wander_size

    def advance(self, rows: Rows, now: Moment) -> None:
        """Let the biases drift for a period."""
        if not self._drifts:
            return
        entries = self._entries
        drawn = normal(now.seed, f"{self._name} drift", now.episodes[rows], now.steps[rows], 2 * entries)
        self._bias[rows] += drawn[:, :entries] * self._walk
        self._wander[rows] = self._wander[rows] * self._kept + drawn[:, entries:] * self._stirred

    def applied(self, reading: Reading, rows: Rows, now: Moment) -> Reading:
        """What the instruments in `rows` make of their true `reading` (len(rows), ...)."""
        value = reading.reshape(len(reading), -1) + (self._bias[rows] + self._wander[rows])
        if self._noise.any():
            place = now.episodes[rows], now.steps[rows], self._entries
            value += normal(now.seed, f"{self._name} noise", *place) * self._noise
        if len(self._stepped):
            value[:, self._stepped] = np.rint(value[:, self._stepped] / self._quantum) * self._quantum
        if len(self._turning):
            value[:, self._turning] = wrap_angle(value[:, self._turning])
        if np.issubdtype(self._type, np.integer):
            np.rint(value, out=value)
        return within(value, self._low, self._high).astype(self._type).reshape(reading.shape)


def realistic(sensor: Sensor, conf: RealismConf | None, num_scenes: int, step_s: float) -> Sensor:
    """`sensor` with the faults of `conf`; itself where there are none."""
    return sensor if conf is None else Realism(sensor, conf, num_scenes, step_s)


def _merged(part: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a part, and those given in their stead."""
    merged = {**part, **given}
    for name, settings in part.items():
        if isinstance(settings, Mapping) and isinstance(given.get(name), Mapping):
            merged[name] = {**settings, **given[name]}
    return merged
