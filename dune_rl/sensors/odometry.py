"""Odometry: where the wheels' turns say that a rover is; slip makes it drift, as on the real one."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.encoders import EncodersConf, WheelCounter
from dune_rl.sensors.realism.pipeline import OdometryRealismConf
from dune_rl.sensors.sensor import PI32, Bounds, Reading, joints_of
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.sensor_carrier import WheelMotion
from dune_rl.state.state import GroupState, State


class OdometryConf(SensorSettings):
    """Limit of the position; the wheels' turns are counted as by the sensor `encoders`."""

    sensor: Literal["odometry"] = "odometry"
    realism: OdometryRealismConf | None = None
    range_m: float = Field(
        100.0,
        gt=0.0,
        le=1_000_000.0,
        description="x and y since the episode's start are clipped to this either way [m]",
    )


@dataclass(frozen=True)
class DriveGeometry:
    """Radius of the wheels, the track that tells their difference as a turn, and which wheels are where.

    A skid-steer's wheels scrub sideways when it turns, so that `track_m` is wider than the distance between
    them. `left` and `right` are indices of drive joints.
    """

    wheel_radius_m: float
    track_m: float
    left: tuple[int, ...]
    right: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("wheel_radius_m", "track_m"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} is {value}; a length above 0 m is needed")
        if not self.left or not self.right:
            raise ValueError("left and right need a wheel each, by the index of its drive joint")
        wheels = self.left + self.right
        if len(set(wheels)) < len(wheels) or min(wheels) < 0:
            raise ValueError(
                f"left {self.left} and right {self.right} must name different wheels, counted from 0"
            )

    @property
    def num_wheels(self) -> int:
        """Number of wheels up to the last one that is named."""
        return max(self.left + self.right) + 1

    @cached_property
    def _means(self) -> Array:
        """Way ahead and turn by each wheel's turn, (W, 2)."""
        means = np.zeros((self.num_wheels, 2))
        radius = self.wheel_radius_m
        for side, sign in ((self.left, -1.0), (self.right, 1.0)):
            means[list(side)] = np.array([radius / 2, sign * radius / self.track_m]) / len(side)
        return means

    def motion(self, turned: Array, angles: Array) -> Array:
        """See `WheelMotion`: the mean of the sides, and their difference over the track."""
        means = self._means
        if len(means) < turned.shape[1]:
            turned = turned[:, : len(means)]
        found: Array = turned @ means
        return found


class Odometry:
    """The reading "odometry", (M, 5): x, y [m], yaw [rad], forward speed [m/s] and yaw rate [rad/s].

    The pose is in the frame of the episode's start, x forward; the twist is the
    mean of the last control step. All come from the wheels' turns, counted as
    `EncodersConf` says: of sideways slip, spin and slopes they know nothing.
    """

    needs_joints: ClassVar[bool] = True

    def __init__(self, name: str, context: SensorContext, conf: OdometryConf) -> None:
        geometry: WheelMotion | None = context.carrier.drive
        if geometry is None:
            raise ConfigError(
                f"odometry is of wheels, and this robot has none; leave {name} out of its sensors"
            )
        encoders: EncodersConf = context.settings_of("encoders")
        num_rows, num_wheels, step_s = context.num_rows, context.carrier.num_joints, context.step_s
        self._name = name
        if geometry.num_wheels > num_wheels:
            raise ValueError(
                f"left and right name wheel {geometry.num_wheels - 1}; the last of {num_wheels} is "
                f"{num_wheels - 1}"
            )
        self._counter = WheelCounter(encoders, num_rows, num_wheels, step_s)
        self._step_s, self._geometry = step_s, geometry
        fastest = encoders.max_speed_radps * geometry.wheel_radius_m
        limits = [conf.range_m, conf.range_m, PI32, fastest, 2 * fastest / geometry.track_m]
        # In float64 for clipping, yet rounded: what is clipped stays within bounds that are float32.
        self._highest = np.array(limits, np.float32).astype(np.float64)
        self._pose = np.zeros((num_rows, 3))
        self._reading = np.zeros((num_rows, 5), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """The range, whole turns, and what wheels do at the fastest that is counted."""
        high = self._highest.astype(np.float32)
        return {self._name: (-high, high)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Put the origin where the rovers in `mask` (M,) stand."""
        self._counter.begin(mask, joints_of(now).angle)
        self._pose[mask] = 0.0
        self._reading[mask] = 0.0

    def measure(self, now: GroupState, state: State) -> None:
        """Go on by the wheels' turns over the control step that has just ended."""
        angle = joints_of(now).angle
        motion = self._geometry.motion(self._counter.turned(angle), angle)
        ahead, turn = motion[:, 0], motion[:, 1]
        # The chord of an arc: shorter than it, along the mean of its headings.
        chord = ahead * np.sinc(turn / (2 * np.pi))
        heading = self._pose[:, 2] + turn / 2
        self._pose[:, 0] += chord * np.cos(heading)
        self._pose[:, 1] += chord * np.sin(heading)
        self._pose[:, 2] = wrap_angle(self._pose[:, 2] + turn)
        reading = np.concatenate([self._pose, motion / self._step_s], axis=1)
        self._reading = clip(reading, -self._highest, self._highest).astype(np.float32)

    def read(self) -> dict[str, Reading]:
        """The latest pose and twist."""
        return {self._name: self._reading.copy()}
