"""Robots on wheels that steer by skidding: their actions are a speed and a heading."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.paths import assets_folder
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.robot import BodyMotion, RobotDescription, WheelLayout

# Limit of the integral, so that a rover that cannot turn does not wind it up.
_MAX_CORRECTION_RADPS = 2.0


class SkidSteerConf(Settings):
    """Geometry and limits of the drive, and its motors.

    Wheels that scrub sideways turn the body less than plain kinematics says. `effective_track_m` is the
    track that gives the commanded yaw rates on average, wider than the real one; how much wider depends on
    the ground. A PI loop on the gyroscope's yaw rate corrects the rest.

    A wheel's motor has `max_torque_nm` up to `full_torque_speed_radps` and, if `no_load_speed_radps` is set,
    linearly less from there up to that speed, minus `gear_friction_nm`; `rotor_inertia_kgm2` is the rotor's
    inertia reflected to the wheel. `max_wheel_speed_radps` limits the target speed of a wheel.
    """

    wheel_radius_m: float = Field(0.125, gt=0.0)
    effective_track_m: float = Field(0.5, gt=0.0)
    yaw_rate_kp: float = Field(0.4, ge=0.0, le=1.0)
    yaw_rate_ki_per_s: float = Field(8.0, ge=0.0, le=20.0)
    max_speed_mps: float = Field(1.0, gt=0.0, le=10.0)
    max_yaw_rate_radps: float = Field(2.0, gt=0.0, le=10.0)
    max_acceleration_mps2: float = Field(5.0, gt=0.0)
    max_yaw_acceleration_radps2: float = Field(4.0, gt=0.0)
    max_torque_nm: float = Field(6.0, gt=0.0)
    full_torque_speed_radps: float = Field(0.0, ge=0.0)
    no_load_speed_radps: float | None = Field(None, gt=0.0)
    gear_friction_nm: float = Field(0.0, ge=0.0)
    rotor_inertia_kgm2: float = Field(0.0, ge=0.0)
    max_wheel_speed_radps: float | None = Field(None, gt=0.0)

    @model_validator(mode="after")
    def _torque_ends_after_it_begins_to_fall(self) -> Self:
        if self.no_load_speed_radps is not None and self.full_torque_speed_radps >= self.no_load_speed_radps:
            raise ValueError(
                f"full_torque_speed_radps ({self.full_torque_speed_radps}) must be less than "
                f"no_load_speed_radps ({self.no_load_speed_radps})"
            )
        return self


class SkidSteerDrive:
    """Converts commanded twists of N robots, with limited rates of change, to speeds of their wheels."""

    def __init__(self, conf: SkidSteerConf, num_robots: int) -> None:
        self._conf = conf
        self._speed = np.zeros(num_robots)
        self._yaw_rate = np.zeros(num_robots)
        self._correction = np.zeros(num_robots)

    def reset(self, mask: Flags) -> None:
        """Set the twist to zero and clear the yaw rate's loop for the robots in `mask` (N,)."""
        self._speed[mask] = 0.0
        self._yaw_rate[mask] = 0.0
        self._correction[mask] = 0.0

    def wheel_speeds(
        self, speed: Array, yaw_rate: Array, measured_yaw_rate: Array, step_s: float
    ) -> tuple[Array, Array]:
        """Speeds of left and right wheels [rad/s], each (N,), for a commanded twist [m/s, rad/s], each (N,).

        `measured_yaw_rate` (N,) is the gyroscope's about the body's z [rad/s].
        """
        conf = self._conf
        speed = clip(speed, -conf.max_speed_mps, conf.max_speed_mps)
        yaw_rate = clip(yaw_rate, -conf.max_yaw_rate_radps, conf.max_yaw_rate_radps)
        gain = conf.max_acceleration_mps2 * step_s
        turn_gain = conf.max_yaw_acceleration_radps2 * step_s
        self._speed = clip(speed, self._speed - gain, self._speed + gain)
        self._yaw_rate = clip(yaw_rate, self._yaw_rate - turn_gain, self._yaw_rate + turn_gain)
        error = self._yaw_rate - measured_yaw_rate
        correction = self._correction + conf.yaw_rate_ki_per_s * step_s * error
        self._correction = clip(correction, -_MAX_CORRECTION_RADPS, _MAX_CORRECTION_RADPS)
        turn = self._yaw_rate + conf.yaw_rate_kp * error + self._correction
        side = turn * (conf.effective_track_m / 2)
        return (self._speed - side) / conf.wheel_radius_m, (self._speed + side) / conf.wheel_radius_m


class WheeledRobot:
    """N robots with wheels on two sides: a `Robot`.

    `description` is completed by the drive's limits and the wheels; `on_left` is true for each motor whose
    wheel is on the left.
    """

    def __init__(
        self,
        description: RobotDescription,
        body: RobotBody,
        *,
        heading: HeadingConf,
        drive: SkidSteerConf,
        on_left: Sequence[bool],
        num_robots: int,
    ) -> None:
        self.body = body
        self._on_left = np.array(on_left)
        left, right = (tuple(np.flatnonzero(side).tolist()) for side in (self._on_left, ~self._on_left))
        self.description = replace(
            description,
            max_speed_mps=drive.max_speed_mps,
            max_yaw_rate_radps=drive.max_yaw_rate_radps,
            max_acceleration_mps2=drive.max_acceleration_mps2,
            max_yaw_acceleration_radps2=drive.max_yaw_acceleration_radps2,
            heading_gain_per_s=heading.kp,
            wheels=WheelLayout(drive.wheel_radius_m, drive.effective_track_m, left, right),
        )
        self._heading = HeadingController(heading, drive.max_yaw_rate_radps, num_robots)
        self._drive = SkidSteerDrive(drive, num_robots)

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


ROVER_WHEELS = tuple(f"{end}_{side}_wheel" for end in ("front", "rear") for side in ("left", "right"))


def rover_body(
    name: str, size: RobotDescription, drive: SkidSteerConf, wheel_friction: float, hub_m: float = 0.0
) -> RobotBody:
    """The rover called `name` in `assets/robots`, with four wheels, their motors and tyres.

    A tyre's centre is `hub_m` inward of its wheel's joint.
    """
    return RobotBody(
        urdf=assets_folder() / "robots" / name / f"{name}.urdf",
        motors=tuple(wheel_motor(f"{wheel}_joint", drive) for wheel in ROVER_WHEELS),
        ground_links=ROVER_WHEELS,
        ground_friction=wheel_friction,
        tyres=tuple(
            Tyre(
                wheel,
                size.contact_radius_m,
                size.contact_width_m,
                (x, y, z),
                (0.0, math.copysign(hub_m, -y), 0.0),
            )
            for wheel, (x, y, z) in zip(ROVER_WHEELS, size.contact_centres_b.tolist(), strict=True)
        ),
    )


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
