"""What real instruments add to the truth: rate, latency, noise, drifting biases and steps between values."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Flags
from dune_rl.sensors.draws import Rows
from dune_rl.sensors.realism.noise import AngleNoiseConf, Faults, ImuFaults, NoiseConf
from dune_rl.sensors.realism.presets import SensorKind, find_preset
from dune_rl.sensors.sensor import Bounds, Reading, Sensor
from dune_rl.state.state import GroupState, State

_ALL: Rows = slice(None)


class RealismConf(Settings):
    """Rate and latency of a sensor; classes derived from this add its own faults.

    Without `rate_hz` it reads each control step, with it at the beginning of an episode and from then on at
    that rate, which must divide the control rate. A reading arrives `latency_s` late, a whole number of
    control steps; until then the first reading of the episode is given.

    Classes for a `kind` of sensor take the name of a device: alone ("bno055"), or as
    `preset` beside settings that differ. "perfect" has no faults at all.

    `layout` names the field with the faults of each entry of a reading; with `repeats`, of equal runs of
    entries.
    """

    kind: ClassVar[SensorKind | None] = None
    layout: ClassVar[tuple[str, ...]] = ()
    repeats: ClassVar[bool] = False

    preset: str | None = Field(None, description="name of a known device, for what is not set")
    rate_hz: float | None = Field(
        None, gt=0.0, le=10_000.0, description="readings a second [Hz]; null: one each control step"
    )
    latency_s: float = Field(
        0.0, ge=0.0, le=2.0, description="delay of a reading [s], a whole number of control steps"
    )

    @model_validator(mode="before")
    @classmethod
    def _of_part(cls, data: Any) -> Any:
        if data == "perfect":
            return {}
        if isinstance(data, str):
            data = {"preset": data}
        if not isinstance(data, Mapping) or not isinstance(data.get("preset"), str):
            return data
        if cls.kind is None:
            raise ValueError(f"preset must be null (got {data['preset']!r}): no devices are known here")
        merged = {**find_preset(data["preset"], cls.kind).settings}
        for name, given in data.items():
            both = isinstance(given, Mapping) and isinstance(merged.get(name), Mapping)
            merged[name] = {**merged[name], **given} if both else given
        return merged

    def with_own_faults(self, sensor: Sensor, num_rows: int, step_s: float) -> Sensor:
        """The sensor with faults that are no noise of single entries; itself where there are none."""
        return sensor

    def channels(self, size: int) -> tuple[NoiseConf, ...]:
        """Faults of each of the `size` entries of a reading; none at all for a sensor with its own."""
        each = size // len(self.layout) if self.layout and self.repeats else 1
        return tuple(getattr(self, name) for name in self.layout for _ in range(each))

    def faults(self, name: str, bounds: Bounds, num_rows: int, period_s: float) -> Faults | None:
        """The faults of the reading `name`, read every `period_s`; None for a sensor with its own."""
        channels = self.channels(bounds[0].size)
        return self.made(name, bounds, channels, num_rows, period_s) if channels else None

    @property
    def made(self) -> type[Faults]:
        """The class of the faults of entries."""
        return Faults

    def fit_to(self, step_s: float) -> Self:
        """The same with the nearest rate and latency that control steps of `step_s` allow."""
        every = 1 if self.rate_hz is None else max(1, round(1.0 / (step_s * self.rate_hz)))
        rate_hz = None if every == 1 else 1.0 / (every * step_s)
        late_s = round(self.latency_s / step_s) * step_s
        return self.model_copy(update={"rate_hz": rate_hz, "latency_s": late_s})

    def steps(self, step_s: float) -> tuple[int, int]:
        """Control steps of `step_s` between two readings, and until a reading arrives; or ValueError."""
        control_hz, every, late = 1.0 / step_s, 1.0, self.latency_s / step_s
        if self.rate_hz is not None:
            every = control_hz / self.rate_hz
            if every < 1.0 - 1e-3:
                raise ValueError(
                    f"rate_hz={self.rate_hz:g} is above the control rate of {control_hz:g} Hz; "
                    f"write {control_hz:g} or a whole fraction of it, or null for every control step"
                )
            if abs(every - round(every)) > 1e-3 * every:
                near = " or ".join(f"{control_hz / steps:.4g}" for steps in (int(every), int(every) + 1))
                raise ValueError(
                    f"rate_hz={self.rate_hz:g} does not divide the control rate of {control_hz:g} Hz; "
                    f"write {near}"
                )
        if abs(late - round(late)) > 1e-3:
            near = " or ".join(f"{steps * step_s:.4g}" for steps in (int(late), int(late) + 1))
            raise ValueError(
                f"latency_s={self.latency_s:g} is not a whole number of control steps of {step_s:g} s; "
                f"write {near}"
            )
        return round(every), round(late)


class ImuRealismConf(RealismConf):
    """Faults of an inertial unit: `tilt` is of roll and pitch, `heading` of yaw.

    Where `heading_from` is the gyroscope, yaw is the integral of its rate since the episode began, so that
    the errors of the rate add up, and `heading.bias` is the error of the yaw with which it began; a
    magnetometer's has the faults of `heading` alone.
    """

    kind = "imu"
    layout = (*("accelerometer",) * 3, *("gyroscope",) * 3, "tilt", "tilt", "heading")

    heading_from: Literal["gyroscope", "magnetometer"] = Field(
        "gyroscope", description="source of yaw: the integrated gyroscope, which drifts, or a magnetometer"
    )

    accelerometer: NoiseConf = NoiseConf()
    gyroscope: NoiseConf = NoiseConf()
    tilt: AngleNoiseConf = AngleNoiseConf()
    heading: AngleNoiseConf = AngleNoiseConf()

    @property
    def made(self) -> type[Faults]:
        """With a heading that drifts where the gyroscope gives it."""
        return ImuFaults if self.heading_from == "gyroscope" else Faults


class SpeedRealismConf(RealismConf):
    """Faults of what a rover's own controller knows: `forward` [m/s] and `turn` [rad/s]."""

    layout = ("forward", "turn")

    forward: NoiseConf = NoiseConf()
    turn: NoiseConf = NoiseConf()


class ReadingRealismConf(RealismConf):
    """Faults of a sensor whose entries are all alike: heights, depths, currents."""

    layout = ("each",)
    repeats = True

    each: NoiseConf = NoiseConf()


class EncoderRealismConf(RealismConf):
    """Faults of wheel encoders: of each `turn` [rad], and of each `speed` [rad/s]."""

    layout = ("turn", "speed")
    repeats = True

    turn: NoiseConf = NoiseConf()
    speed: NoiseConf = NoiseConf()


class OdometryRealismConf(RealismConf):
    """Faults of dead reckoning: `place` is of x and y [m], `forward` [m/s] and `turn` [rad/s] of speeds."""

    layout = ("place", "place", "heading", "forward", "turn")

    place: NoiseConf = NoiseConf()
    heading: AngleNoiseConf = AngleNoiseConf()
    forward: NoiseConf = NoiseConf()
    turn: NoiseConf = NoiseConf()


class GoalRealismConf(RealismConf):
    """Faults of what is known of the goal: `distance` [m] and `bearing` [rad]."""

    layout = ("distance", "bearing")

    distance: NoiseConf = NoiseConf()
    bearing: AngleNoiseConf = AngleNoiseConf()


class PositionRealismConf(RealismConf):
    """Faults of a satellite receiver and a compass: `place` is of x and y [m], `height` of z [m]."""

    kind = "position"
    layout = ("place", "place", "height", "heading")

    place: NoiseConf = NoiseConf()
    height: NoiseConf = NoiseConf()
    heading: AngleNoiseConf = AngleNoiseConf()


class Realism:
    """A sensor seen through the faults of `conf`; within its bounds and of its types.

    The stages follow one another as in an instrument: a reading is taken at the rate; biases and noise are
    added; it falls on a step between values and is held to the range; it arrives late, and is held until the
    next. What is random depends on the seed, the episode and its step alone.
    """

    def __init__(self, sensor: Sensor, conf: RealismConf, num_rows: int, step_s: float) -> None:
        self._sensor = sensor
        self.needs_joints = getattr(sensor, "needs_joints", False)
        self._every, delay = conf.steps(step_s)
        self._faults: dict[str, Faults] = {}
        self._ring: dict[str, Reading] = {}
        for name, bounds in sensor.bounds().items():
            self._ring[name] = np.zeros((delay + 1, num_rows, *bounds[0].shape), bounds[0].dtype)
            faults = conf.faults(name, bounds, num_rows, self._every * step_s)
            if faults is not None:
                self._faults[name] = faults
        self._slots, self._newest = delay + 1, 0

    def bounds(self) -> dict[str, Bounds]:
        """Those of the sensor within."""
        return self._sensor.bounds()

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read, and forget what the agents in `mask` (N,) have read before."""
        self._sensor.begin(mask, now, state)
        rows = np.flatnonzero(mask)
        for name, reading in self._sensor.read().items():
            fresh = reading[rows]
            if name in self._faults:
                self._faults[name].begin(rows, now)
                fresh = self._faults[name].applied(fresh, rows, now)
            self._ring[name][:, rows] = fresh

    def measure(self, now: GroupState, state: State) -> None:
        """Read where a reading is due, and let the others stand."""
        self._sensor.measure(now, state)
        rows, is_due, partly = _ALL, True, False
        if self._every > 1:
            due = now.episode.steps % self._every == 0
            is_due, partly = bool(due.any()), not due.all()
            rows = np.flatnonzero(due) if partly else _ALL
        readings = self._sensor.read() if is_due else {}
        before = self._newest
        self._newest = (before + 1) % self._slots
        for name, ring in self._ring.items():
            if partly:
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


def realistic(sensor: Sensor, conf: RealismConf | None, num_rows: int, step_s: float) -> Sensor:
    """`sensor` with the rate, latency and noise of `conf`; itself where this is None."""
    if conf is None:
        return sensor
    return Realism(conf.with_own_faults(sensor, num_rows, step_s), conf, num_rows, step_s)
