"""Skid-steer drive: from a commanded twist to wheel speeds, within the platform's limits."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import clip
from dune_rl.settings import Settings

Array = NDArray[np.float64]

# A rover held fast must not wind the loop up.
_MAX_CORRECTION_RADPS = 2.0


class SkidSteerConf(Settings):
    """Limits and geometry of the drive.

    Wheels that scrub sideways turn the body less than plain kinematics says,
    so the track that makes commands come true on the average is wider than the
    real one. How much less depends on the ground; a loop on the gyroscope's
    yaw rate makes up the rest.

    A wheel's motor gives `max_torque_nm` at rest and, where `no_load_speed_radps`
    is given, in a straight line nothing at that speed; `gear_friction_nm` comes
    off it, and `rotor_inertia_kgm2` is the rotor's as felt at the wheel. A wheel
    is told to turn at `max_wheel_speed_radps` at the most.
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
    no_load_speed_radps: float | None = Field(None, gt=0.0)
    gear_friction_nm: float = Field(0.0, ge=0.0)
    rotor_inertia_kgm2: float = Field(0.0, ge=0.0)
    max_wheel_speed_radps: float | None = Field(None, gt=0.0)


class SkidSteerDrive:
    """Rate-limited twist of each of M scenes, as speeds of left and right wheels."""

    def __init__(self, conf: SkidSteerConf, num_scenes: int) -> None:
        self._conf = conf
        self._speed = np.zeros(num_scenes)
        self._yaw_rate = np.zeros(num_scenes)
        self._correction = np.zeros(num_scenes)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Stand still in the scenes in `mask` (M,)."""
        self._speed[mask] = 0.0
        self._yaw_rate[mask] = 0.0
        self._correction[mask] = 0.0

    def wheel_speeds(
        self, speed: Array, yaw_rate: Array, measured_yaw_rate: Array, step_s: float
    ) -> tuple[Array, Array]:
        """Left and right wheel speed [rad/s], each (M,), toward a commanded twist [m/s, rad/s], each (M,).

        `measured_yaw_rate` (M,) is the gyroscope's about the body's z [rad/s].
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
