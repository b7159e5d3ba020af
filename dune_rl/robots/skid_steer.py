"""Skid-steer drive: wheel speeds for a commanded twist, within the platform's limits."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip

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
