"""What a robot knows of its own motion by its instruments, faults included."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.sensors.sensor import Sensor
from dune_rl.state.state import GroupState, State

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
    def yaw(self) -> Array:
        """Yaw by the inertial unit [rad], (N,)."""
        return self.motion.roll_pitch_yaw[:, 2]

    @property
    def velocity_w(self) -> Array:
        """Velocity along the body's x axis in the world frame [m/s], (N, 3)."""
        return self.rotation[:, :, 0] * self.motion.velocity_b[:, :1]

    def receiver_position(self) -> Array:
        """Position by the receiver [m], (N, 3)."""
        return self.instruments["position"].read()["position"][:, :3].astype(np.float64)


@dataclass(frozen=True)
class KnownPose:
    """Where N robots are, as they know it: `position_w`, `velocity_w` (N, 3) [m, m/s], `yaw` (N,) [rad]."""

    position_w: Array
    velocity_w: Array
    yaw: Array

    @classmethod
    def of(cls, navigation: Navigation | None, now: GroupState) -> "KnownPose":
        """By the receiver, the speed and the inertial unit; the truth of `now` without `navigation`."""
        if navigation is None:
            return cls(now.motion.position_w, now.motion.velocity_w, now.motion.yaw)
        return cls(navigation.receiver_position(), navigation.velocity_w, navigation.yaw)
