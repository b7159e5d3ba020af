"""What all robots on wheels that steer by skidding share: commands of speed and heading, and their size."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.frames import clip
from dune_rl.physics.interface import RobotBody
from dune_rl.physics.motors import Motor
from dune_rl.robots.battery import BatteryConf
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.mounts import MountsConf
from dune_rl.robots.robot import BodyMotion, RectangularHull, WheelLayout, speed_and_heading_bounds
from dune_rl.robots.skid_steer import SkidSteerConf, SkidSteerDrive

Array = NDArray[np.float64]


class WheeledRobot(RectangularHull):
    """M robots driven by (speed, heading) commands through wheels on two sides: a `Robot` but for its size.

    `on_left` tells of each motor whether its wheel is a left one; `wheel_positions_b`
    (W, 3) are the centres of the wheels that it stands on.
    """

    length_m: float
    width_m: float
    height_m: float
    standing_height_m: float
    contact_radius_m: float
    contact_width_m: float
    mass_kg: float
    wheel_positions_b: Array

    def __init__(
        self,
        *,
        heading: HeadingConf,
        drive: SkidSteerConf,
        body: RobotBody,
        on_left: Sequence[bool],
        mounts: MountsConf,
        battery: BatteryConf,
        num_scenes: int,
    ) -> None:
        self.body, self.mounts, self.battery = body, mounts, battery
        self._drive_conf = drive
        self._on_left = np.array(on_left)
        self._heading = HeadingController(heading, drive.max_yaw_rate_radps, num_scenes)
        self._drive = SkidSteerDrive(drive, num_scenes)

    @property
    def contact_centres_b(self) -> Array:
        """Centres (W, 3) of the wheels [m]."""
        return self.wheel_positions_b

    @property
    def wheels(self) -> WheelLayout:
        """The wheels' turns as a motion."""
        left, right = (tuple(np.flatnonzero(side).tolist()) for side in (self._on_left, ~self._on_left))
        return WheelLayout(self._drive_conf.wheel_radius_m, self._drive_conf.effective_track_m, left, right)

    @property
    def max_speed_mps(self) -> float:
        """Largest speed that can be commanded."""
        return self._drive_conf.max_speed_mps

    def action_bounds(self) -> tuple[Array, Array]:
        """Bounds, each (2,), of speed [m/s] and heading relative to the present one [rad]."""
        return speed_and_heading_bounds(self.max_speed_mps)

    def rest_action(self) -> Array:
        """No speed and no turn, (2,)."""
        return np.zeros(2)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Stand still and forget the past in the scenes in `mask` (M,)."""
        self._heading.reset(mask)
        self._drive.reset(mask)

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """Target speed of each wheel [rad/s], (M, W), for an `action` (M, 2); see `wheel_commands`."""
        return self.wheel_commands(action, motion.angular_b[:, 2], step_s)

    def wheel_commands(self, action: Array, measured_yaw_rate: Array, step_s: float) -> Array:
        """Target speed of each motor's wheel [rad/s], (M, W).

        `action` (M, 2) is the speed [m/s] and the heading relative to the
        present one [rad]; both are clipped to the platform's limits.
        `measured_yaw_rate` (M,) is the gyroscope's [rad/s].
        """
        error = clip(action[:, 1], -np.pi, np.pi)
        yaw_rate = self._heading.yaw_rate(error, step_s)
        left, right = self._drive.wheel_speeds(action[:, 0], yaw_rate, measured_yaw_rate, step_s)
        return np.where(self._on_left, left[:, None], right[:, None])


def wheel_motor(joint: str, drive: SkidSteerConf) -> Motor:
    """The motor of a wheel, as the drive's settings have it."""
    unlimited = np.inf
    return Motor(
        joint,
        drive.max_torque_nm,
        max_speed_radps=unlimited if drive.max_wheel_speed_radps is None else drive.max_wheel_speed_radps,
        no_load_speed_radps=unlimited if drive.no_load_speed_radps is None else drive.no_load_speed_radps,
        gear_friction_nm=drive.gear_friction_nm,
        rotor_inertia_kgm2=drive.rotor_inertia_kgm2,
    )
