"""Sensors on wheels: encoders, odometry from their counts, and motor currents."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import EncoderRealismConf, OdometryRealismConf, ReadingRealismConf
from dune_rl.sensors.sensor import PI32, VectorSensor, joints_of
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.sensor_carrier import WheelMotion
from dune_rl.state.state import GroupState, State


class EncodersConf(SensorSettings):
    """Counts in a turn of the wheel, and the fastest that is counted; 0 counts is an encoder without steps.

    The default is what a six-step Hall sensor gives through the gears of the
    Rover Zero: its maker's driver (RoverRobotics/librover, protocol_zero_2.hpp)
    takes 96 * 2 electrical turns of the motor for one of the wheel.
    """

    sensor: Literal["encoders"] = "encoders"
    realism: EncoderRealismConf | None = None
    counts_per_turn: int = Field(1152, ge=0, le=10_000_000, description="counts in a turn; 0: no steps")
    max_speed_radps: float = Field(100.0, gt=0.0, le=10_000.0, description="limit of readings [rad/s]")


class WheelCounter:
    """How far the W wheels of M rovers turn from one control step to the next, as encoders tell it.

    Counts are whole since the start of the episode, so that what one step rounds away the next one brings.
    """

    def __init__(self, conf: EncodersConf, num_rows: int, num_wheels: int, step_s: float) -> None:
        # An encoder without steps counts radians.
        self._count_rad = 2 * np.pi / conf.counts_per_turn if conf.counts_per_turn else 1.0
        self._whole = conf.counts_per_turn > 0
        self.most_rad = conf.max_speed_radps * step_s
        self._start = np.zeros((num_rows, num_wheels))
        self._counts = np.zeros((num_rows, num_wheels))

    def begin(self, mask: Flags, angle: Array) -> None:
        """Count from `angle` (N, J) [rad] in the agents in `mask` (N,); the wheels are the first joints."""
        self._start[mask] = angle[mask, : self._start.shape[1]]
        self._counts[mask] = 0.0

    def turned(self, angle: Array) -> Array:
        """Turn of each wheel to `angle` (N, J) since the last call [rad], (N, W); at most `most_rad`."""
        counts = (angle[:, : self._start.shape[1]] - self._start) / self._count_rad
        if self._whole:
            counts = np.rint(counts)
        turned = (counts - self._counts) * self._count_rad
        self._counts = counts
        return clip(turned, -self.most_rad, self.most_rad)


class Encoders(VectorSensor):
    """The reading "encoders", (N, 2 * W): how far each wheel has turned in the last control step, and speeds.

    Turns [rad] come first; the speeds [rad/s] after them are those turns by the
    length of a step. Wheels are in the order of the robot's drive joints.
    """

    needs_joints: ClassVar[bool] = True

    def __init__(self, name: str, context: SensorContext, conf: EncodersConf) -> None:
        num_rows, num_wheels, step_s = context.num_rows, context.carrier.num_joints, context.step_s
        self._counter = WheelCounter(conf, num_rows, num_wheels, step_s)
        self._step_s = step_s
        most = self._counter.most_rad
        highest = np.repeat([most, most / step_s], num_wheels)
        super().__init__(name, num_rows, -highest, highest)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Nothing has turned in the agents in `mask` (N,)."""
        self._counter.begin(mask, joints_of(now).angle)
        self._reading[mask] = 0.0

    def measure(self, now: GroupState, state: State) -> None:
        turned = self._counter.turned(joints_of(now).angle)
        self._store(np.concatenate([turned, turned / self._step_s], axis=1))


class OdometryConf(SensorSettings):
    """Limit of the position; the wheels' turns are counted as by the sensor `encoders`."""

    sensor: Literal["odometry"] = "odometry"
    realism: OdometryRealismConf | None = None
    range_m: float = Field(100.0, gt=0.0, le=1_000_000.0, description="limit of x and y [m]")


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


class Odometry(VectorSensor):
    """The reading "odometry", (N, 5): x, y [m], yaw [rad], forward speed [m/s] and yaw rate [rad/s].

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
        if geometry.num_wheels > num_wheels:
            raise ValueError(
                f"left and right name wheel {geometry.num_wheels - 1}; the last of {num_wheels} is "
                f"{num_wheels - 1}"
            )
        self._counter = WheelCounter(encoders, num_rows, num_wheels, step_s)
        self._step_s, self._geometry = step_s, geometry
        fastest = encoders.max_speed_radps * geometry.wheel_radius_m
        limits = [conf.range_m, conf.range_m, PI32, fastest, 2 * fastest / geometry.track_m]
        super().__init__(name, num_rows, np.negative(limits), limits)
        self._pose = np.zeros((num_rows, 3))

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Put the origin where the agents in `mask` (N,) stand."""
        self._counter.begin(mask, joints_of(now).angle)
        self._pose[mask] = 0.0
        self._reading[mask] = 0.0

    def measure(self, now: GroupState, state: State) -> None:
        angle = joints_of(now).angle
        motion = self._geometry.motion(self._counter.turned(angle), angle)
        ahead, turn = motion[:, 0], motion[:, 1]
        # The chord of an arc: shorter than it, along the mean of its headings.
        chord = ahead * np.sinc(turn / (2 * np.pi))
        heading = self._pose[:, 2] + turn / 2
        self._pose[:, 0] += chord * np.cos(heading)
        self._pose[:, 1] += chord * np.sin(heading)
        self._pose[:, 2] = wrap_angle(self._pose[:, 2] + turn)
        self._store(np.concatenate([self._pose, motion / self._step_s], axis=1))


class CurrentsConf(SensorSettings):
    """Motor and gear of a wheel. The defaults stand for the Rover Zero's and are estimates.

    The gear's 96 is that of its maker's driver (RoverRobotics/librover,
    protocol_zero_2.hpp: 96 * 2 electrical turns for one of the wheel, two a turn
    of the motor). The torque constant follows from the 17,000 electrical turns
    a minute that the driver allows: 8,500 rpm at some 15 V are 570 rpm/V, and
    9.55 / 570 = 0.017 N m/A. Efficiency and limit are usual for such gears and
    motor controllers.
    """

    # An estimate: a hundredth of the current that motors may draw.
    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.1))

    sensor: Literal["currents"] = "currents"
    torque_constant_nm_per_a: float = Field(0.017, gt=0.0, le=10.0, description="of the motor [N m/A]")
    gear_ratio: float = Field(96.0, gt=0.0, le=1_000.0, description="turns of the motor for one of the wheel")
    efficiency: float = Field(0.7, gt=0.0, le=1.0, description="share of the torque that the gears leave")
    limit_a: float = Field(10.0, gt=0.0, le=1_000.0, description="readings are clipped to this [A]")


class Currents(VectorSensor):
    """The reading "currents", (N, W) [A], clipped to ± `limit_a`: positive where the torque is forward.

    Losses in the gears take torque from a motor that drives its wheel, and hold
    a wheel that would drive its motor. The torque is that of the last physics
    step; the motor's own inertia and its current without load are left out.
    """

    needs_joints: ClassVar[bool] = True

    def __init__(self, name: str, context: SensorContext, conf: CurrentsConf) -> None:
        num_wheels = context.carrier.num_joints
        self._driving_a_per_nm = 1.0 / (conf.torque_constant_nm_per_a * conf.gear_ratio * conf.efficiency)
        self._driven_a_per_nm = self._driving_a_per_nm * conf.efficiency**2
        self._num_wheels = num_wheels
        highest = np.full(num_wheels, conf.limit_a)
        super().__init__(name, context.num_rows, -highest, highest)

    def measure(self, now: GroupState, state: State) -> None:
        joints, wheels = joints_of(now), self._num_wheels
        torque = joints.torque[:, :wheels]
        driving = torque * joints.speed[:, :wheels] > 0.0
        current = torque * np.where(driving, self._driving_a_per_nm, self._driven_a_per_nm)
        self._store(current)
