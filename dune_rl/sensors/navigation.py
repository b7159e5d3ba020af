"""What a robot knows of its own motion by its instruments, faults included."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.frames import rotation_from_angles, wrap_angle
from dune_rl.sensors.sensor import PI32, Bounds, Reading, Sensor
from dune_rl.sensors.velocity import MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS
from dune_rl.state.state import GroupState, State

_ODOMETRY_SPEED = 3
_GYROSCOPE, _ATTITUDE = slice(3, 6), slice(6, 9)


@dataclass(frozen=True)
class ControllerMotion:
    """What a robot's controller may know: `velocity_b`, `angular_b`, `roll_pitch_yaw`, each (N, 3).

    Body frame [m/s, rad/s]; angles in [rad].
    """

    velocity_b: Array
    angular_b: Array
    roll_pitch_yaw: Array


class Navigation:
    """Motion and pose of N robots as their instruments give them, by dead reckoning.

    `instruments` have an inertial unit "imu" and a speed "velocity", in the order in which they are read, and
    a receiver "position" where something needs it. Attitude and turn rates are the inertial unit's; the pose
    (`position_w`, `rotation`) begins at (0, 0, 0) with an episode and goes on by the speed along the body's x
    axis, the mean of its directions before and after the step. Sideways slip is not known to it.
    """

    def __init__(self, instruments: Mapping[str, Sensor], num_rows: int, step_s: float) -> None:
        self.instruments = dict(instruments)
        self._step_s = step_s
        self.position_w = np.zeros((num_rows, 3))
        self.rotation = np.tile(np.eye(3), (num_rows, 1, 1))
        self.motion = ControllerMotion(*np.zeros((3, num_rows, 3)))

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read the instruments at the start of the episodes in `mask` (N,), at the origin."""
        for sensor in self.instruments.values():
            sensor.begin(mask, now, state)
        self.position_w = np.where(mask[:, None], 0.0, self.position_w)
        self._read()

    def measure(self, now: GroupState, state: State) -> None:
        """Read the instruments at the end of a control step, and go on by them."""
        for sensor in self.instruments.values():
            sensor.measure(now, state)
        before = self.rotation[:, :, 0]
        self._read()
        ahead = (before + self.rotation[:, :, 0]) / 2
        self.position_w = self.position_w + ahead * (self.motion.velocity_b[:, :1] * self._step_s)

    def _read(self) -> None:
        imu = self.instruments["imu"].read()["imu"].astype(np.float64)
        velocity = np.zeros((len(imu), 3))
        velocity[:, 0] = self.instruments["velocity"].read()["velocity"][:, 0]
        self.motion = ControllerMotion(velocity, imu[:, _GYROSCOPE], imu[:, _ATTITUDE])
        self.rotation = rotation_from_angles(imu[:, _ATTITUDE])

    @property
    def heading(self) -> Array:
        """Yaw by the inertial unit [rad], (N,)."""
        return self.motion.roll_pitch_yaw[:, 2]

    def receiver_position(self) -> Array:
        """Horizontal position by the receiver [m], (N, 2)."""
        return self.instruments["position"].read()["position"][:, :2].astype(np.float64)


class EstimatedVelocity:
    """The reading "velocity", (N, 2): speed by `speed` [m/s] and yaw rate by the inertial unit [rad/s].

    `speed` is wheel odometry, or a velocity sensor on a body without wheels. Neither is read here: they must
    have been read before.
    """

    def __init__(self, speed: Sensor, imu: Sensor, num_rows: int) -> None:
        self._speed, self._imu = speed, imu
        self._highest = np.array([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS], np.float32)
        self._reading: Floats = np.zeros((num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """As of the true velocity."""
        return {"velocity": (-self._highest, self._highest)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Take both from the latest readings."""
        speed = self._speed.read()
        ahead = speed["odometry"][:, _ODOMETRY_SPEED] if "odometry" in speed else speed["velocity"][:, 0]
        reading = np.stack([ahead, self._imu.read()["imu"][:, 5]], axis=1)
        self._reading = np.minimum(np.maximum(reading, -self._highest), self._highest)

    def read(self) -> dict[str, Reading]:
        """The latest speed and yaw rate."""
        return {"velocity": self._reading.copy()}


class EstimatedGoal:
    """The reading `name`, (N, 2): distance [m] and bearing [rad] of the goal by the robot's own position.

    The goal's coordinates are known; where the robot is, it knows by its receiver, and its heading by its
    inertial unit. Distances are at most `farthest_m`.
    """

    def __init__(self, navigation: Navigation, num_rows: int, farthest_m: float, name: str = "goal") -> None:
        self._navigation, self._farthest_m, self._name = navigation, farthest_m, name
        self._reading: Floats = np.zeros((num_rows, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """As of the true goal."""
        low, high = [0.0, -PI32], [self._farthest_m, PI32]
        return {self._name: (np.array(low, np.float32), np.array(high, np.float32))}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Compute both from the latest readings of the navigation."""
        offset = now.goal.position_w - self._navigation.receiver_position()
        reading = np.empty((len(offset), 2), np.float32)
        reading[:, 0] = np.minimum(np.hypot(offset[:, 0], offset[:, 1]), self._farthest_m)
        reading[:, 1] = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - self._navigation.heading)
        self._reading = reading

    def read(self) -> dict[str, Reading]:
        """The latest distance and bearing."""
        return {self._name: self._reading.copy()}
