"""Interface of a robot: its constants, its actions, and the motor commands that its controller computes."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.robot_body import RobotBody
from dune_rl.robots.ackermann import SteeringGeometry
from dune_rl.robots.settings import BatteryConf, MountsConf


class BodyMotion(Protocol):
    """Input of a robot's own controller: twist and attitude of N bodies, without their positions.

    A controller uses nothing else of a robot's motion. The environment passes the true motion or, with
    `realism` of any sensor, the readings of odometry and IMU, with their faults, so that no controller has a
    channel that a real one lacks.
    """

    @property
    def velocity_b(self) -> Array:
        """Velocity in the body frame [m/s], (N, 3)."""

    @property
    def angular_b(self) -> Array:
        """Angular velocity in the body frame [rad/s], (N, 3)."""

    @property
    def roll_pitch_yaw(self) -> Array:
        """Roll, pitch and yaw [rad], (N, 3)."""


@dataclass(frozen=True)
class WheelLayout:
    """Odometry's model of the wheels: rolling radius [m], effective track [m], and motors of each side.

    `track_m` is the difference of the sides' speeds [m/s] over the yaw rate [rad/s]. `left` and `right` are
    indices of motors, which are the first ones. `steering` is the geometry of a robot whose wheels steer,
    None for one that skids.
    """

    radius_m: float
    track_m: float
    left: tuple[int, ...]
    right: tuple[int, ...]
    steering: SteeringGeometry | None = None

    @property
    def num_driven(self) -> int:
        """Number of wheels with motors."""
        return len(self.left) + len(self.right)


@dataclass(frozen=True, eq=False)
class ActionRange:
    """Lowest and highest action, and the action at which the robot stands still, each (A,)."""

    low: Array
    high: Array
    rest: Array


def speed_and_heading_range(max_speed_mps: float) -> ActionRange:
    """Range of a speed [m/s] and a heading relative to the present one [rad]; at rest both are 0."""
    high = np.array([max_speed_mps, np.pi])
    return ActionRange(-high, high, np.zeros(2))


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """Constants of a kind of robot.

    Frame: x forward, y left, z up; the origin is that of the URDF's base link, `standing_height_m` above
    level ground. `length_m`, `width_m` and `height_m` are the sizes of the bounding box of hull and wheels
    or legs at full stride; seen from above, the origin is its centre. `contact_centres_b` (W, 3) [m] are the
    centres of the wheels or feet at the start of an episode, of `contact_radius_m` and `contact_width_m`, in
    the order of `RobotBody.ground_links`; the first wheels belong to the first motors, and those behind them
    have none.

    `max_speed_mps` and `max_yaw_rate_radps` are the largest that can be commanded, the accelerations those
    with which commands are followed at most, and `heading_gain_per_s` is the yaw rate over the heading error,
    at rest. `mounts` are the default poses of the sensors; `battery`
    supplies the motors. `wheels` is None for a robot with legs. `joint_actions` is the range of actions that
    are not a speed and a heading.
    """

    length_m: float
    width_m: float
    height_m: float
    standing_height_m: float
    mass_kg: float
    contact_centres_b: Array
    contact_radius_m: float
    contact_width_m: float
    max_speed_mps: float = 1.0
    max_yaw_rate_radps: float = 1.0
    max_acceleration_mps2: float = np.inf
    max_yaw_acceleration_radps2: float = np.inf
    heading_gain_per_s: float = 2.0
    mounts: MountsConf = field(default_factory=MountsConf)
    battery: BatteryConf = field(default_factory=lambda: BatteryConf(capacity_wh=90.0))
    wheels: WheelLayout | None = None
    joint_actions: ActionRange | None = None

    @property
    def actions(self) -> ActionRange:
        """The range of actions: of speed and heading, unless the robot has `joint_actions`."""
        return self.joint_actions or speed_and_heading_range(self.max_speed_mps)

    @property
    def half_size_m(self) -> Array:
        """Half of length and width [m], (2,)."""
        return np.array([self.length_m, self.width_m]) / 2

    @property
    def footprint_radius_m(self) -> float:
        """Radius of a circle about the origin that contains the outline."""
        return float(np.hypot(self.length_m / 2, self.width_m / 2))

    def outline(self) -> Array:
        """Points (P, 2) [m] on the outline, seen from above, in the body frame, at most 0.16 m apart."""
        return rectangle_outline(self.length_m, self.width_m)


class Robot(Protocol):
    """N robots of one kind that are driven by actions: N = number of scenes * agents of a group.

    `body` is the robot as the physics engine loads it.
    """

    description: RobotDescription
    body: RobotBody

    def reset(self, mask: Flags) -> None:
        """Reset the controllers of the robots in `mask` (N,)."""

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """Command of each motor, (N, J): a speed [rad/s] or an angle [rad], by `Motor.mode`.

        `action` (N, A) is clipped to the range of actions. To be called once per control step of `step_s`, in
        order: controllers have state.
        """


def rectangle_outline(length_m: float, width_m: float, spacing_m: float = 0.16) -> Array:
    """Points (P, 2) [m] on a rectangle about the origin, neighbours at most `spacing_m` apart."""
    x, y = length_m / 2, width_m / 2
    ahead = np.linspace(-x, x, max(5, int(np.ceil(length_m / spacing_m)) + 1))
    across = np.linspace(-y, y, max(5, int(np.ceil(width_m / spacing_m)) + 1))[1:-1]
    sides = [np.column_stack([ahead, np.full(len(ahead), side)]) for side in (-y, y)]
    ends = [np.column_stack([np.full(len(across), end), across]) for end in (-x, x)]
    return np.concatenate([*sides, *ends])
