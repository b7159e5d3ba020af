"""Rover Zero, four-wheel drive: the paper's test platform."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import within
from dune_rl.paths import assets_folder
from dune_rl.physics.interface import RobotBody
from dune_rl.robots.heading import HeadingConf, HeadingController
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
    """M rovers driven by (speed, heading) commands.

    Frame: x forward, y left, z up, origin at the chassis centre,
    `standing_height_m` above level ground.
    """

    length_m = 0.62
    width_m = 0.44
    height_m = 0.254
    standing_height_m = 0.125
    mass_kg = 11.0
    wheel_width_m = 0.083
    # Contact points of the wheels in the body frame [m]: where the rover stands on the ground.
    wheel_positions_b = np.array(
        [[0.1415, 0.18, 0.0], [0.1415, -0.18, 0.0], [-0.145, 0.18, 0.0], [-0.145, -0.18, 0.0]]
    )

    def __init__(self, conf: RoverZeroConf, num_scenes: int) -> None:
        self.conf = conf
        self._heading = HeadingController(conf.heading, conf.drive.max_yaw_rate_radps, num_scenes)
        self._drive = SkidSteerDrive(conf.drive, num_scenes)
        self.body = RobotBody(
            urdf=assets_folder() / "robots" / "rover_zero" / "rover_zero.urdf",
            drive_joints=tuple(
                f"{end}_{side}_wheel_joint" for end in ("front", "rear") for side in ("left", "right")
            ),
            max_torque_nm=conf.drive.max_torque_nm,
            wheel_friction=conf.wheel_friction,
        )

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
        x, y = self.length_m / 2, self.width_m / 2
        ahead, across = np.linspace(-x, x, 5), np.linspace(-y, y, 5)[1:-1]
        sides = [np.column_stack([ahead, np.full(5, side)]) for side in (-y, y)]
        ends = [np.column_stack([np.full(3, end), across]) for end in (-x, x)]
        return np.concatenate([*sides, *ends])

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Stand still and forget the past in the scenes in `mask` (M,)."""
        self._heading.reset(mask)
        self._drive.reset(mask)

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
