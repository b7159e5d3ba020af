"""Robots on wheels that steer by skidding: their actions are a speed and a heading."""

from collections.abc import Sequence

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody
from dune_rl.robots.battery import BatteryConf
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.mounts import MountsConf
from dune_rl.robots.robot import BodyMotion, RectangularHull, WheelLayout, speed_and_heading_bounds
from dune_rl.robots.skid_steer import SkidSteerConf, SkidSteerDrive


class WheeledRobot(RectangularHull):
    """N robots with wheels on two sides: a `Robot` without its sizes, which a subclass sets.

    `on_left` is true for each motor whose wheel is on the left; `wheel_positions_b` (W, 3) [m] are the
    centres of the wheels.
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
        num_robots: int,
    ) -> None:
        self.body, self.mounts, self.battery = body, mounts, battery
        self._drive_conf, self._heading_conf = drive, heading
        self._on_left = np.array(on_left)
        self._heading = HeadingController(heading, drive.max_yaw_rate_radps, num_robots)
        self._drive = SkidSteerDrive(drive, num_robots)

    @property
    def contact_centres_b(self) -> Array:
        """Centres (W, 3) [m] of the wheels."""
        return self.wheel_positions_b

    @property
    def wheels(self) -> WheelLayout:
        """Model of the wheels for odometry."""
        left, right = (tuple(np.flatnonzero(side).tolist()) for side in (self._on_left, ~self._on_left))
        return WheelLayout(self._drive_conf.wheel_radius_m, self._drive_conf.effective_track_m, left, right)

    @property
    def max_speed_mps(self) -> float:
        """Largest speed that can be commanded."""
        return self._drive_conf.max_speed_mps

    @property
    def max_yaw_rate_radps(self) -> float:
        """Largest yaw rate that can be commanded."""
        return self._drive_conf.max_yaw_rate_radps

    @property
    def heading_gain_per_s(self) -> float:
        """Yaw rate over heading error, at rest."""
        return self._heading_conf.kp

    def action_bounds(self) -> tuple[Array, Array]:
        """Bounds, each (2,), of speed [m/s] and heading relative to the present one [rad]."""
        return speed_and_heading_bounds(self.max_speed_mps)

    def rest_action(self) -> Array:
        """Zero speed and no turn, (2,)."""
        return np.zeros(2)

    def reset(self, mask: Flags) -> None:
        """Reset the controllers of the robots in `mask` (N,)."""
        self._heading.reset(mask)
        self._drive.reset(mask)

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """Target speed of each wheel [rad/s], (N, W), for an `action` (N, 2); see `wheel_commands`."""
        return self.wheel_commands(action, motion.angular_b[:, 2], step_s)

    def wheel_commands(self, action: Array, measured_yaw_rate: Array, step_s: float) -> Array:
        """Target speed of each wheel [rad/s], (N, W).

        `action` (N, 2) is the speed [m/s] and the heading relative to the present one [rad], both clipped
        to the platform's limits. `measured_yaw_rate` (N,) is the gyroscope's [rad/s].
        """
        error = clip(action[:, 1], -np.pi, np.pi)
        yaw_rate = self._heading.yaw_rate(error, step_s)
        left, right = self._drive.wheel_speeds(action[:, 0], yaw_rate, measured_yaw_rate, step_s)
        return np.where(self._on_left, left[:, None], right[:, None])


def wheel_motor(joint: str, drive: SkidSteerConf) -> Motor:
    """The motor of a wheel's joint, from the settings of the drive."""
    unlimited = np.inf
    return Motor(
        joint,
        drive.max_torque_nm,
        max_speed_radps=unlimited if drive.max_wheel_speed_radps is None else drive.max_wheel_speed_radps,
        no_load_speed_radps=unlimited if drive.no_load_speed_radps is None else drive.no_load_speed_radps,
        full_torque_speed_radps=drive.full_torque_speed_radps,
        gear_friction_nm=drive.gear_friction_nm,
        rotor_inertia_kgm2=drive.rotor_inertia_kgm2,
    )
