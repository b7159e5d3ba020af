"""HyperDog: a quadruped with twelve servos, driven by speed and heading or by its joints' angles."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.paths import assets_folder
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.hyperdog.gait import Leg, Trot, TrotConf
from dune_rl.robots.robot import ActionRange, BodyMotion, RobotDescription
from dune_rl.robots.settings import BatteryConf, MountsConf, RobotSettings

_LEGS = ("front_left", "front_right", "rear_left", "rear_right")
_JOINTS = ("hip", "upper", "lower")
_HIPS_B = np.array([[0.175, 0.066, 0.0], [0.175, -0.066, 0.0], [-0.175, 0.066, 0.0], [-0.175, -0.066, 0.0]])
_SIDE = np.sign(_HIPS_B[:, 1])
_LIMITS_RAD = np.array([[-1.57, 1.57], [-1.22, 3.14], [0.17, 2.62]])
_LIMITS_OF_ALL = np.tile(_LIMITS_RAD, (4, 1)).T
_LEG = Leg(offset_m=0.104, upper_m=0.150, lower_m=0.145, knee_rad=(0.17, 2.62))
_FOOT_RADIUS_M = 0.02
# Limits of the integrals of speed [m/s] and yaw rate [rad/s].
_MAX_CORRECTION = np.array([0.06, 0.4])


class HyperDogMountsConf(MountsConf):
    """LiDAR on the rear of the back, camera in the head, IMU at the body's centre."""

    scanner_b: tuple[float, float, float] = (-0.04, 0.0, 0.1)
    camera_b: tuple[float, float, float] = (0.24, 0.0, 0.028)
    camera_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HyperDogConf(RobotSettings):
    """Settings of the dog: kind of action, gait, servos, mounts and battery.

    `action` is `speed_and_heading`, as for rovers, or `joints`: twelve joint angles, each scaled to [-1, 1]
    over the joint's range, of the legs front left, front right, rear left, rear right; of each leg hip,
    upper, lower.
    """

    name: Literal["hyperdog"] = "hyperdog"
    action: Literal["speed_and_heading", "joints"] = "speed_and_heading"
    heading: HeadingConf = HeadingConf()
    gait: TrotConf = TrotConf()
    max_speed_mps: float = Field(0.4, gt=0.0, le=1.0)
    max_yaw_rate_radps: float = Field(1.0, gt=0.0, le=3.0)
    max_acceleration_mps2: float = Field(1.0, gt=0.0)
    max_yaw_acceleration_radps2: float = Field(2.0, gt=0.0)
    speed_ki_per_s: float = Field(0.5, ge=0.0, le=10.0)
    yaw_rate_ki_per_s: float = Field(1.0, ge=0.0, le=10.0)
    max_torque_nm: float = Field(10.0, gt=0.0)
    no_load_speed_radps: float | None = Field(10.0, gt=0.0)
    foot_friction: float = Field(1.0, gt=0.0, le=3.0)
    mounts: HyperDogMountsConf = HyperDogMountsConf()
    battery: BatteryConf = BatteryConf(capacity_wh=73.9, idle_w=40.0, efficiency=0.16)

    @property
    def standing_height_m(self) -> float:
        """Height of the origin over level ground."""
        return self.gait.height_m + _FOOT_RADIUS_M


class HyperDog:
    """N dogs: a `Robot`.

    Frame: x forward, y left, z up; the origin is the body's centre, `standing_height_m` above level ground.
    """

    def __init__(self, conf: HyperDogConf, num_robots: int) -> None:
        self.conf = conf
        self._heading = HeadingController(conf.heading, conf.max_yaw_rate_radps, num_robots)
        self._trot = Trot(conf.gait, _HIPS_B, num_robots)
        self._target = np.zeros((num_robots, 2))
        self._correction = np.zeros((num_robots, 2))
        self._yaw = np.full(num_robots, np.nan)
        rest = _LEG.angles(self._trot.rest_b - _HIPS_B, _SIDE)
        self.description = RobotDescription(
            # Over the knees at full stride, and over the feet in the fastest turn. It stands on 0.58 m by
            # 0.37 m.
            length_m=0.67,
            width_m=0.47,
            height_m=0.30,
            standing_height_m=conf.standing_height_m,
            mass_kg=5.0,
            contact_centres_b=self._trot.rest_b,
            contact_radius_m=_FOOT_RADIUS_M,
            contact_width_m=2 * _FOOT_RADIUS_M,
            max_speed_mps=conf.max_speed_mps,
            max_yaw_rate_radps=conf.max_yaw_rate_radps,
            heading_gain_per_s=conf.heading.kp,
            mounts=conf.mounts,
            battery=conf.battery,
            joint_actions=_joint_actions(rest.ravel()) if conf.action == "joints" else None,
        )
        no_load = np.inf if conf.no_load_speed_radps is None else conf.no_load_speed_radps
        self.body = RobotBody(
            urdf=assets_folder() / "robots" / "hyperdog" / "hyperdog.urdf",
            motors=tuple(
                Motor(
                    f"{leg}_{joint}_joint",
                    conf.max_torque_nm,
                    mode="position",
                    position_gain_per_s=80.0,
                    max_speed_radps=no_load,
                    no_load_speed_radps=no_load,
                    rest_rad=float(angle),
                )
                for leg, angles in zip(_LEGS, rest, strict=True)
                for joint, angle in zip(_JOINTS, angles, strict=True)
            ),
            ground_links=tuple(f"{leg}_lower" for leg in _LEGS),
            ground_friction=conf.foot_friction,
            ground_links_meet_obstacles=True,
        )

    def reset(self, mask: Flags) -> None:
        """Reset gait and controllers of the robots in `mask` (N,)."""
        self._heading.reset(mask)
        self._trot.reset(mask)
        self._target[mask] = 0.0
        self._correction[mask] = 0.0
        self._yaw[mask] = np.nan

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """Angle of each joint [rad], (N, 12), to be reached at the end of the step."""
        if self.conf.action == "joints":
            low, high = _LIMITS_OF_ALL
            return low + (clip(action, -1.0, 1.0) + 1.0) / 2.0 * (high - low)
        tilt = motion.roll_pitch_yaw[:, :2]
        twist = self._twist(action, self._trot.speed_share(tilt), motion, step_s)
        feet = self._trot.feet(twist, tilt, step_s)
        angles = _LEG.angles(feet - _HIPS_B, _SIDE)
        return clip(angles, *_LIMITS_RAD.T).reshape(len(action), 12)

    def _twist(self, action: Array, speed_share: Array, motion: BodyMotion, step_s: float) -> Array:
        """Speed [m/s] and yaw rate [rad/s] of the gait, (N, 2)."""
        conf = self.conf
        limit = conf.max_speed_mps
        speed = speed_share * clip(action[:, 0], -limit, limit)
        turn = self._heading.yaw_rate(clip(action[:, 1], -np.pi, np.pi), step_s)
        gain = step_s * np.array([conf.max_acceleration_mps2, conf.max_yaw_acceleration_radps2])
        target = np.column_stack([speed, turn])
        self._target = clip(target, self._target - gain, self._target + gain)
        # An integral of the error compensates for the slip of the feet. The yaw rate is measured over the
        # control step, because the body sways and the rate at its end is not the mean.
        yaw = motion.roll_pitch_yaw[:, 2]
        turned = np.where(np.isnan(self._yaw), 0.0, wrap_angle(yaw - self._yaw))
        self._yaw = yaw.copy()
        measured = np.column_stack([motion.velocity_b[:, 0], turned / step_s])
        gains = np.array([conf.speed_ki_per_s, conf.yaw_rate_ki_per_s])
        change = step_s * gains * (self._target - measured)
        self._correction = clip(self._correction + change, -_MAX_CORRECTION, _MAX_CORRECTION)
        # A robot that is commanded to stand does not walk to correct its position.
        standing = (speed == 0.0) & (turn == 0.0)
        self._correction[standing] = 0.0
        # A tilted robot does not correct its speed fully: it would push harder against what stops it.
        shares = np.column_stack([speed_share, np.ones_like(speed_share)])
        return self._target + self._correction * shares


def _joint_actions(rest_rad: Array) -> ActionRange:
    """Range of scaled joint angles, (12,) each; at rest the joints are at `rest_rad` (12,)."""
    low, high = _LIMITS_OF_ALL
    return ActionRange(-np.ones(12), np.ones(12), 2.0 * (rest_rad - low) / (high - low) - 1.0)
