"""HyperDog: a quadruped with twelve servos that trots at a speed and heading, or takes its joints' angles."""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.paths import assets_folder
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.robot import ActionRange, BodyMotion, RobotDescription
from dune_rl.robots.settings import BatteryConf, MountsConf, RobotSettings


@dataclass(frozen=True)
class Leg:
    """Lengths of a leg [m], and the range of its knee [rad].

    The hip turns about x and holds the leg `offset_m` outward. Upper leg, `upper_m` long, and lower leg,
    `lower_m` long, swing forward for positive angles (about -y). With all angles at zero the leg hangs
    straight down. `knee_rad` limits the knee angle, lowest and highest: the lower leg bends forward only,
    as in a dog's hind leg.
    """

    offset_m: float
    upper_m: float
    lower_m: float
    knee_rad: tuple[float, float]

    def foot(self, angles: Array, side: Array) -> Array:
        """Position of the foot (..., 3) [m] relative to the hip joint: x forward, y left, z up.

        `angles` (..., 3) [rad] are those of hip, upper and lower leg; `side` (...) is 1 for a left leg, -1
        for a right one.
        """
        hip, upper, lower = (angles[..., i] for i in range(3))
        ahead = self.upper_m * np.sin(upper) + self.lower_m * np.sin(upper + lower)
        down = self.upper_m * np.cos(upper) + self.lower_m * np.cos(upper + lower)
        out = side * self.offset_m
        across = out * np.cos(hip) + down * np.sin(hip)
        up = out * np.sin(hip) - down * np.cos(hip)
        return np.stack([ahead, across, up], axis=-1)

    def angles(self, foot: Array, side: Array) -> Array:
        """Joint angles (..., 3) [rad] for a foot at `foot` (..., 3) [m], or near it if out of reach."""
        ahead, across, up = (foot[..., i] for i in range(3))
        out = side * self.offset_m
        down = np.sqrt(np.maximum(across**2 + up**2 - self.offset_m**2, 1e-8))
        hip = np.arctan2(up, across) - np.arctan2(-down, out)
        hip = (hip + np.pi) % (2 * np.pi) - np.pi
        reach2 = ahead**2 + down**2
        bend = (reach2 - self.upper_m**2 - self.lower_m**2) / (2 * self.upper_m * self.lower_m)
        knee = clip(np.arccos(clip(bend, -1.0, 1.0)), *self.knee_rad)
        upper = np.arctan2(ahead, down) - np.arctan2(
            self.lower_m * np.sin(knee), self.upper_m + self.lower_m * np.cos(knee)
        )
        return np.stack([hip, upper, knee], axis=-1)


# Phase offsets of the legs in the order of the hips: front left with rear right, front right with rear left.
_PHASE_OFFSETS = np.array([0.0, 0.5, 0.5, 0.0])
# Below both, the robot stands.
_MIN_SPEED_MPS, _MIN_YAW_RATE_RADPS = 0.01, 0.02
# Limit of the tangent of roll and pitch that foot placement compensates.
_MAX_TILT_TANGENT = 0.45
# Share of the distance to its rest position that a foot moves in a control step when the gait ends.
_SETTLING_SHARE = 0.2


class TrotConf(Settings):
    """Shape of the gait.

    In a cycle of `cycle_s` each foot swings for `swing_share` of it, lifted by `lift_m` on half a sine. The
    hips are `height_m` above the feet, which are `out_m` outward of them. From a tilt of
    `slow_from_tilt_deg` to `slow_to_tilt_deg` the speed falls linearly to `slow_speed_share` of the commanded
    one, which prevents falls on stones and steps.
    """

    cycle_s: float = Field(0.5, ge=0.2, le=2.0)
    swing_share: float = Field(0.25, ge=0.1, le=0.5)
    lift_m: float = Field(0.06, gt=0.0, le=0.1)
    height_m: float = Field(0.22, ge=0.15, le=0.27)
    out_m: float = Field(0.10, ge=0.0, le=0.15)
    slow_from_tilt_deg: float = Field(10.3, ge=0.0, le=85.0)
    slow_to_tilt_deg: float = Field(24.1, ge=0.0, le=85.0)
    slow_speed_share: float = Field(0.25, gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _slow_in_order(self) -> Self:
        if self.slow_to_tilt_deg <= self.slow_from_tilt_deg:
            raise ValueError(
                f"slow_to_tilt_deg must be above slow_from_tilt_deg "
                f"(got {self.slow_to_tilt_deg:g} and {self.slow_from_tilt_deg:g})"
            )
        return self


class Trot:
    """Positions of the four feet of N robots, in the body frame."""

    def __init__(self, conf: TrotConf, hips_b: Array, num_robots: int) -> None:
        self._conf = conf
        self._slow_from_rad, self._slow_to_rad = np.deg2rad([conf.slow_from_tilt_deg, conf.slow_to_tilt_deg])
        outward = conf.out_m * np.sign(hips_b[:, 1])
        self.rest_b: Array = hips_b + np.column_stack([np.zeros(4), outward, np.full(4, -conf.height_m)])
        self._phase = np.zeros(num_robots)
        self._feet = np.tile(self.rest_b, (num_robots, 1, 1))
        self._lift_off = self._feet.copy()

    def reset(self, mask: Flags) -> None:
        """Put all feet of the robots in `mask` (N,) at their rest positions."""
        self._phase[mask] = 0.0
        self._feet[mask] = self.rest_b
        self._lift_off[mask] = self.rest_b

    def speed_share(self, tilt: Array) -> Array:
        """Share (N,) of the commanded speed at which to walk, by roll and pitch (N, 2) [rad]."""
        conf = self._conf
        excess = np.hypot(tilt[:, 0], tilt[:, 1]) - self._slow_from_rad
        share = clip(excess / (self._slow_to_rad - self._slow_from_rad), 0.0, 1.0)
        return 1.0 - (1.0 - conf.slow_speed_share) * share

    def feet(self, twist: Array, tilt: Array, step_s: float) -> Array:
        """Positions (N, 4, 3) [m] of the feet after another `step_s`.

        `twist` (N, 2) is the speed [m/s] and the yaw rate [rad/s] of the walk, `tilt` (N, 2) the body's roll
        and pitch [rad]: on a slope feet land vertically below the hips. With zero twist, feet move to
        their rest positions.
        """
        conf = self._conf
        walks = (np.abs(twist[:, 0]) > _MIN_SPEED_MPS) | (np.abs(twist[:, 1]) > _MIN_YAW_RATE_RADPS)
        self._phase = np.where(walks, (self._phase + step_s / conf.cycle_s) % 1.0, 0.0)
        phase = (self._phase[:, None] + _PHASE_OFFSETS) % 1.0
        swinging = (phase < conf.swing_share) & walks[:, None]
        share = np.minimum(phase / conf.swing_share, 1.0)
        velocity, below_hips = self._ground_velocity(twist), self._below_hips(tilt)
        # Half a stance ahead, so that the foot is below its hip in the middle of the stance.
        landing = below_hips + velocity * (conf.cycle_s * (1.0 - conf.swing_share) / 2)
        swing = self._swing_positions(share, landing)
        stance = self._feet - step_s * velocity
        stance[..., 2] = self.rest_b[:, 2]
        standing = self._feet + _SETTLING_SHARE * (below_hips - self._feet)
        self._feet = np.where(swinging[..., None], swing, np.where(walks[:, None, None], stance, standing))
        self._lift_off = np.where(swinging[..., None], self._lift_off, self._feet)
        return self._feet

    def _ground_velocity(self, twist: Array) -> Array:
        """Velocity of the body over the ground at each foot's rest position, (N, 4, 3) [m/s]."""
        speed, turn = twist[:, :1], twist[:, 1:]
        along = speed - turn * self.rest_b[:, 1]
        across = turn * self.rest_b[:, 0]
        return np.stack([along, across, np.zeros_like(along)], axis=-1)

    def _below_hips(self, tilt: Array) -> Array:
        """Positions (N, 4, 3) [m] of feet vertically below their hips."""
        offset = self._conf.height_m * clip(np.tan(tilt), -_MAX_TILT_TANGENT, _MAX_TILT_TANGENT)
        offsets = np.stack([offset[:, 1], -offset[:, 0], np.zeros(len(tilt))], axis=-1)
        return np.asarray(self.rest_b + offsets[:, None])

    def _swing_positions(self, share: Array, landing: Array) -> Array:
        """Positions (N, 4, 3) [m] of feet that have done `share` (N, 4) of a swing to `landing` (N, 4, 3)."""
        eased = 0.5 - 0.5 * np.cos(np.pi * share)
        positions = self._lift_off + eased[..., None] * (landing - self._lift_off)
        positions[..., 2] += self._conf.lift_m * np.sin(np.pi * share)
        return positions


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
            max_acceleration_mps2=conf.max_acceleration_mps2,
            max_yaw_acceleration_radps2=conf.max_yaw_acceleration_radps2,
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
