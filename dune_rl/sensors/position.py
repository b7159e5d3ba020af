"""Position and heading in the world, as a satellite receiver and a compass tell them."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.geometry.frames import clip
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.draws import normal
from dune_rl.sensors.realism.pipeline import PositionRealismConf
from dune_rl.sensors.sensor import PI32, Bounds, Reading
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# An error beyond this many standard deviations, one reading in 16,000, is clipped at the world's edge.
_FARTHEST_DRIFT = 4.0


class PositionConf(SensorSettings):
    """A slow error of the position, as satellites' orbits and the air make it; without one it is the true.

    The drifts are standard deviations, of x and y each and of z. An error fades to a share of 1/e of itself
    in `drift_time_s`, and new ones take its place (a Gauss-Markov process of first order).
    """

    default_realism: ClassVar = PositionRealismConf.model_validate("zed_f9p")

    sensor: Literal["position"] = "position"
    realism: PositionRealismConf | None = None
    drift_horizontal_m: float = Field(
        0.0,
        ge=0.0,
        le=1_000.0,
        description="standard deviation of the slow error of x and of y [m]; 0 is the true position",
    )
    drift_vertical_m: float = Field(
        0.0, ge=0.0, le=1_000.0, description="standard deviation of the slow error of z [m]"
    )
    drift_time_s: float = Field(
        60.0, gt=0.0, le=100_000.0, description="time in which an error fades to 1/e [s]"
    )


class Position:
    """The reading `name`, (N, 4): x, y, z of the body's origin [m] and yaw [rad] in the world frame.

    Readings are clipped to the extent and heights of the world, and to what the drift adds.
    """

    def __init__(self, name: str, context: SensorContext, conf: PositionConf) -> None:
        extent, heights, step_s = context.extent, context.heights, context.step_s
        self._name, self._drift_name = name, f"{name}_drift"
        xmin, xmax, ymin, ymax = extent
        low, high = np.array([xmin, ymin, heights[0]]), np.array([xmax, ymax, heights[1]])
        # Written so that NaN, which compares false, is refused.
        if not ((low <= high).all() and np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError(
                f"extent {extent} and heights {heights} need a finite lowest value, then the highest: "
                "(xmin, xmax, ymin, ymax) and (zmin, zmax)"
            )
        self._spread = np.array([conf.drift_horizontal_m, conf.drift_horizontal_m, conf.drift_vertical_m])
        self._drifts = bool(self._spread.any())
        self._kept = float(np.exp(-step_s / conf.drift_time_s))
        # What is new each step keeps the spread as it is.
        self._renewed = float(np.sqrt(-np.expm1(-2 * step_s / conf.drift_time_s)))
        self._drift = np.zeros((context.num_rows, 3))
        reach = _FARTHEST_DRIFT * self._spread
        # In float64 for clipping, yet rounded: what is clipped stays within bounds that are float32.
        self._low = np.append(low - reach, -PI32).astype(np.float32).astype(np.float64)
        self._high = np.append(high + reach, PI32).astype(np.float32).astype(np.float64)
        self._reading = np.zeros((context.num_rows, 4), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """The world's, widened by the drift's reach, and whole turns."""
        return {self._name: (self._low.astype(np.float32), self._high.astype(np.float32))}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Start the episodes in `mask` (M,) with an error of their own."""
        if self._drifts:
            self._drift = np.where(mask[:, None], self._spread * self._draws(now), self._drift)
        self._take(now)

    def measure(self, now: GroupState, state: State) -> None:
        """Take the present pose, with an error that has moved on."""
        if self._drifts:
            self._drift = self._kept * self._drift + self._renewed * self._spread * self._draws(now)
        self._take(now)

    def _take(self, now: GroupState) -> None:
        reading = np.concatenate(
            [now.motion.position_w + self._drift, now.motion.roll_pitch_yaw[:, 2:]], axis=1
        )
        self._reading = clip(reading, self._low, self._high).astype(np.float32)

    def _draws(self, now: GroupState) -> Floats:
        """Standard normal numbers (N, 3) of the present steps of the episodes."""
        episode = now.episode
        return normal(episode.seed, self._drift_name, episode.streams, episode.steps, 3)

    def read(self) -> dict[str, Reading]:
        """The latest pose."""
        return {self._name: self._reading.copy()}
