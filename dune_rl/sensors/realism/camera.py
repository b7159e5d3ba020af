"""What real cameras add to perfect pictures: shutter, exposure, noise, dirt, and the noise of depth."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.sensors.draws import Rows, draw, normal, uniform
from dune_rl.sensors.realism.pipeline import RealismConf
from dune_rl.sensors.sensor import Bounds, Reading, Sensor
from dune_rl.state.state import GroupState, State

# Light of each byte, and the nearest byte to each of so many levels of light: enough for the darkest.
_LIGHT: Floats = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255.0))
_LEVELS = 2**14
_BYTES = np.searchsorted((_LIGHT[1:] + _LIGHT[:-1]) / 2, np.linspace(0.0, 1.0, _LEVELS)).astype(np.uint8)

_COLOURED = ("rgb", "grey")
# What an automatic exposure aims at, the mean of a picture, in linear light: a grey of 18 %.
_MEAN_LIGHT = 0.18
_MOST_GAIN = 8.0


class CameraRealismConf(RealismConf):
    """Faults of a camera's pictures and depth; segments and normals stay as they are.

    Each row of a picture is exposed for `shutter_s`, the lowest until now and the highest `readout_s` before
    it (a rolling shutter). With `auto_exposure_s` the gain follows what brings the picture's mean to 18 % of
    white times `gain`. Smudges lie elsewhere in each episode. Lost depth reads as where nothing is seen.
    """

    kind = "camera"

    shutter_s: float = Field(0.0, ge=0.0, le=1.0, description="exposure of each row [s]")
    readout_s: float = Field(0.0, ge=0.0, le=1.0, description="time from the first row to the last [s]")
    gain: float = Field(1.0, gt=0.0, le=_MOST_GAIN, description="factor on the brightness")
    auto_exposure_s: float | None = Field(
        None, gt=0.0, le=60.0, description="time constant of the automatic exposure [s]; null: fixed exposure"
    )
    full_well_e: float | None = Field(
        None,
        ge=10.0,
        description="electrons of a white pixel at gain 1, which set the shot noise; null: no noise",
    )
    read_noise_e: float = Field(0.0, ge=0.0, description="standard deviation of the readout [electrons]")
    dirt: float = Field(0.0, ge=0.0, le=1.0, description="share of the light that the worst smudge keeps off")
    smudges: int = Field(6, ge=1, le=64, description="number of smudges on the lens")
    depth_noise_per_m: float = Field(0.0, ge=0.0, le=1.0, description="deviation of a depth z over z² [1/m]")
    depth_quantum_m: float = Field(0.0, ge=0.0, le=10.0, description="step between two depths [m]")
    depth_dropout: float = Field(0.0, ge=0.0, le=1.0, description="share of the pixels without depth")
    depth_near_m: float = Field(0.0, ge=0.0, description="nearest depth that is measured [m]")
    depth_far_m: float | None = Field(None, gt=0.0, description="farthest depth [m]; null: no limit")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.read_noise_e > 0.0 and self.full_well_e is None:
            raise ValueError("read_noise_e is counted in electrons: give full_well_e, some thousands, too")
        if self.depth_far_m is not None and self.depth_far_m <= self.depth_near_m:
            raise ValueError(
                f"depth_far_m ({self.depth_far_m:g}) must be more than depth_near_m ({self.depth_near_m:g})"
            )
        return self

    def fit_to(self, step_s: float) -> Self:
        """As of any sensor; the shutter and the readout are shortened to a control step."""
        fitted, taken_s = super().fit_to(step_s), self.shutter_s + self.readout_s
        share = min(1.0, step_s / taken_s) if taken_s else 1.0
        times = {"shutter_s": share * self.shutter_s, "readout_s": share * self.readout_s}
        return fitted.model_copy(update=times)

    def with_own_faults(self, sensor: Sensor, num_rows: int, step_s: float) -> Sensor:
        """The camera with the faults of its pictures."""
        return CameraFaults(sensor, self, num_rows, step_s)

    def steps(self, step_s: float) -> tuple[int, int]:
        """As of any sensor; a picture must also be taken within a control step."""
        taken_s = self.shutter_s + self.readout_s
        if taken_s > step_s * (1.0 + 1e-6):
            raise ValueError(
                f"shutter_s + readout_s ({taken_s:g}) must be at most the control step of {step_s:g} s; "
                "lessen one of them"
            )
        return super().steps(step_s)


class CameraFaults:
    """A camera's sensor with the faults of `conf`, without rate and latency, which are any sensor's.

    In the order of a camera, in linear light: dirt on the lens, motion while the shutter is open, exposure,
    shot and read noise, bytes. Between two control steps light is taken to change evenly, pixel by pixel: a
    row is the mean of that over its time. What moves by many pixels in a control step is seen twice rather
    than smeared.
    """

    def __init__(self, sensor: Sensor, conf: CameraRealismConf, num_rows: int, step_s: float) -> None:
        self._sensor, self._conf, self._step_s = sensor, conf, step_s
        self._bounds = sensor.bounds()
        # Its readings are called "<name>_<output>".
        self._name = name = next(iter(self._bounds)).rpartition("_")[0]
        self._depth_name = f"{name}_depth"
        self._seen: dict[str, Reading] = {
            name: np.zeros((num_rows, *low.shape), low.dtype) for name, (low, _) in self._bounds.items()
        }
        coloured = [key for key in (f"{name}_{output}" for output in _COLOURED) if key in self._bounds]
        self._gain = {name: np.full((num_rows, 1, 1, 1), conf.gain, np.float32) for name in coloured}
        # To find memory for a batch of pictures costs more than what is worked out in it.
        self._scratch: dict[str, tuple[NDArray[Any], ...]] = {
            name: tuple(np.empty(self._seen[name].shape, kind) for kind in (np.intp, np.float32, np.float32))
            for name in coloured
        }
        self._before: dict[str, Floats] = {}
        height, width = next(iter(self._bounds.values()))[0].shape[:2]
        if conf.shutter_s or conf.readout_s:
            self._before = {name: np.zeros(self._seen[name].shape, np.float32) for name in coloured}
            above = 1.0 - (np.arange(height) + 0.5) / height
            age = (conf.readout_s * above + conf.shutter_s / 2) / step_s
            self._age = age.astype(np.float32).reshape(height, 1, 1)
        self._clear = np.ones((num_rows, height, width, 1), np.float32)
        faults = (conf.shutter_s, conf.readout_s, conf.auto_exposure_s, conf.full_well_e, conf.dirt)
        self._perfect = not any(faults) and conf.gain == 1.0

    def bounds(self) -> dict[str, Bounds]:
        """Those of the sensor within."""
        return self._bounds

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Look in the agents in `mask` (N,), with a lens soiled anew, and nothing seen before."""
        self._sensor.begin(mask, now, state)
        rows = np.flatnonzero(mask)
        if self._conf.dirt:
            self._soil(rows, now)
        self._take(rows, now, first=True)

    def measure(self, now: GroupState, state: State) -> None:
        self._sensor.measure(now, state)
        self._take(slice(None), now, first=False)

    def read(self) -> dict[str, Reading]:
        """The latest pictures."""
        return {name: seen.copy() for name, seen in self._seen.items()}

    def _take(self, rows: Rows, now: GroupState, first: bool) -> None:
        for name, frames in self._sensor.read().items():
            frame = frames[rows]
            if name in self._gain and not self._perfect:
                frame = self._picture(name, frame, rows, now, first)
            elif name == self._depth_name:
                frame = self._depth(frame, rows, now)
            self._seen[name][rows] = frame

    def _picture(
        self, name: str, frame: Reading, rows: Rows, now: GroupState, first: bool
    ) -> NDArray[np.uint8]:
        """Bytes (N, height, width, channels) of the perfect `frame`."""
        conf = self._conf
        index, light, work = (scratch[: len(frame)] for scratch in self._scratch[name])
        index[...] = frame
        np.take(_LIGHT, index, out=light, mode="clip")
        if conf.dirt:
            # What a smudge keeps off comes scattered from everywhere.
            # Along rows first, which is ten times faster.
            by_column = light.reshape(len(light), light.shape[1], -1).mean(axis=1)
            veil = by_column.reshape(len(light), *light.shape[2:]).mean(axis=1)[:, None, None]
            light -= veil
            light *= self._clear[rows]
            light += veil
        if self._before:
            before = self._before[name]
            np.subtract(light if first else before[rows], light, out=work)
            before[rows] = light
            work *= self._age
            light += work
        gain = self._exposure(name, light, rows, first)
        light *= gain
        if conf.full_well_e is not None:
            size = int(np.prod(frame.shape[1:]))
            noise = draw(normal, now.episode, f"{name} noise", size, rows)
            # Electrons e of a pixel vary by √(e + read²); there are full_well / gain of them in white.
            per_electron = gain / np.float32(conf.full_well_e)
            np.add(light, per_electron * np.float32(conf.read_noise_e**2), out=work)
            work *= per_electron
            np.sqrt(work, out=work)
            work *= noise.reshape(frame.shape)
            light += work
        light *= np.float32(_LEVELS - 1)
        light += np.float32(0.5)
        index[...] = light
        taken: NDArray[np.uint8] = _BYTES.take(index, mode="clip")
        return taken

    def _exposure(self, name: str, light: Floats, rows: Rows, first: bool) -> Floats:
        """Gains (N, 1, 1, 1); an automatic one is settled when an episode begins."""
        conf = self._conf
        gains = self._gain[name]
        if conf.auto_exposure_s is not None:
            mean = np.maximum(light.mean(axis=(1, 2, 3), keepdims=True), np.float32(1e-4))
            wanted = np.clip(conf.gain * _MEAN_LIGHT / mean, 1.0 / _MOST_GAIN, _MOST_GAIN)
            kept = 0.0 if first else float(np.exp(-self._step_s / conf.auto_exposure_s))
            gains[rows] = gains[rows] ** kept * wanted ** (1.0 - kept)
        exposed: Floats = gains[rows]
        return exposed

    def _depth(self, frame: Floats, rows: Rows, now: GroupState) -> Floats:
        """Depth (N, height, width, 1) [m] as stereo measures it: an error of disparity grows with depth²."""
        conf = self._conf
        low, high = self._bounds[self._depth_name]
        depth, size = frame, int(np.prod(frame.shape[1:]))
        if conf.depth_noise_per_m:
            noise = draw(normal, now.episode, f"{self._depth_name} noise", size, rows).reshape(frame.shape)
            depth = depth + noise * (np.float32(conf.depth_noise_per_m) * frame * frame)
        if conf.depth_quantum_m:
            depth = np.rint(depth / np.float32(conf.depth_quantum_m)) * np.float32(conf.depth_quantum_m)
        lost = (frame >= high) | (frame < np.float32(conf.depth_near_m))
        if conf.depth_far_m is not None:
            lost |= frame > np.float32(conf.depth_far_m)
        if conf.depth_dropout:
            chance = draw(uniform, now.episode, f"{self._depth_name} return", size, rows)
            lost |= chance.reshape(frame.shape) < conf.depth_dropout
        measured: Floats = np.where(lost, high, np.minimum(np.maximum(depth, low), high))
        return measured

    def _soil(self, rows: NDArray[np.int64], now: GroupState) -> None:
        """Smudges on the lenses of `rows`: soft discs, of a tenth to a third of the picture's width."""
        conf = self._conf
        height, width = self._clear.shape[1:3]
        drawn = draw(uniform, now.episode, f"{self._name} dirt", 4 * conf.smudges, rows, once=True)
        drawn = drawn.reshape(-1, conf.smudges, 4, 1, 1)
        y, x = (np.mgrid[0:height, 0:width].astype(np.float32) + np.float32(0.5)) / np.float32(width)
        clear = np.ones((len(rows), height, width), np.float32)
        for smudge in range(conf.smudges):
            column, row, size, strength = (drawn[:, smudge, part] for part in range(4))
            away = (x - column) ** 2 + (y - row * np.float32(height / width)) ** 2
            radius = np.float32(0.05) + np.float32(0.12) * size
            clear *= 1.0 - np.float32(conf.dirt) * strength * np.exp(-((away / radius**2) ** 2))
        self._clear[rows] = clear[..., None]
