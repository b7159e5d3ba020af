"""Rover Zero, four-wheel drive: the paper's test platform."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import within
from dune_rl.paths import assets_folder
from dune_rl.physics.interface import RobotBody
from dune_rl.physics.motors import Motor
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.robot import BodyMotion, WheelLayout, rectangle_outline, speed_and_heading_bounds
from dune_rl.robots.skid_steer import SkidSteerConf, SkidSteerDrive
from dune_rl.settings import Settings

Array = NDArray[np.float64]


class RoverZeroConf(Settings):
    """Settings of the rover: its heading controller, its drive and its tyres."""

    name: Literal["rover_zero"] = "rover_zero"
    heading: HeadingConf = HeadingConf()
    drive: SkidSteerConf = SkidSteerConf()
    wheel_friction: float = Field(1.0, gt=0.0, le=3.0)


class RoverZero:
    """M rovers driven by (speed, heading) commands: a `Robot`.

    Frame: x forward, y left, z up, origin at the chassis centre,
    `standing_height_m` above level ground.
    """

    length_m = 0.62
    width_m = 0.44
    height_m = 0.254
    standing_height_m = 0.125
    contact_radius_m = 0.125
    # Contact points of the wheels in the body frame [m]: where the rover stands on the ground.
    wheel_positions_b = np.array(
        [[0.1415, 0.18, 0.0], [0.1415, -0.18, 0.0], [-0.145, 0.18, 0.0], [-0.145, -0.18, 0.0]]
    )

    def __init__(self, conf: RoverZeroConf, num_scenes: int) -> None:
        self.conf = conf
        self._heading = HeadingController(conf.heading, conf.drive.max_yaw_rate_radps, num_scenes)
        self._drive = SkidSteerDrive(conf.drive, num_scenes)
        wheels = [f"{end}_{side}_wheel" for end in ("front", "rear") for side in ("left", "right")]
        self.body = RobotBody(
            urdf=assets_folder() / "robots" / "rover_zero" / "rover_zero.urdf",
            motors=tuple(Motor(f"{wheel}_joint", conf.drive.max_torque_nm) for wheel in wheels),
            ground_links=tuple(wheels),
            ground_friction=conf.wheel_friction,
        )

    @property
    def contact_centres_b(self) -> Array:
        """Centres (4, 3) of the wheels [m]."""
        return self.wheel_positions_b

    @property
    def wheels(self) -> WheelLayout:
        """The wheels' turns as a motion."""
        drive = self.conf.drive
        return WheelLayout(drive.wheel_radius_m, drive.effective_track_m, left=(0, 2), right=(1, 3))

    @property
    def max_speed_mps(self) -> float:
        """Largest speed that can be commanded."""
        return self.conf.drive.max_speed_mps

    @property
    def footprint_radius_m(self) -> float:
        """Radius of the circle round the origin that holds the rover at any yaw."""
        return float(np.hypot(self.length_m / 2, self.width_m / 2))

    def outline(self) -> Array:
        """Points (16, 2) round the hull in the body frame [m], at most 0.16 m apart, seen from above."""
        return rectangle_outline(self.length_m, self.width_m)

    def action_bounds(self) -> tuple[Array, Array]:
        """Bounds, each (2,), of speed [m/s] and heading relative to the present one [rad]."""
        return speed_and_heading_bounds(self.max_speed_mps)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Stand still and forget the past in the scenes in `mask` (M,)."""
        self._heading.reset(mask)
        self._drive.reset(mask)

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """Target speed of each wheel [rad/s], (M, 4), for an `action` (M, 2); see `wheel_commands`."""
        return self.wheel_commands(action, motion.angular_b[:, 2], step_s)

    def wheel_commands(self, action: Array, measured_yaw_rate: Array, step_s: float) -> Array:
        """Target speed of each drive joint [rad/s], (M, 4).

        `action` (M, 2) is the speed [m/s] and the heading relative to the
        present one [rad]; both are clipped to the platform's limits.
        `measured_yaw_rate` (M,) is the gyroscope's [rad/s].
        """
        error = within(action[:, 1], -np.pi, np.pi)
        yaw_rate = self._heading.yaw_rate(error, step_s)
        left, right = self._drive.wheel_speeds(action[:, 0], yaw_rate, measured_yaw_rate, step_s)
        return np.stack([left, right, left, right], axis=1)
