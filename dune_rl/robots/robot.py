"""What a robot is to everything above physics: its size, its actions, and what its motors are told."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import RobotBody
from dune_rl.robots.battery import BatteryConf
from dune_rl.robots.mounts import MountsConf

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class BodyMotion(Protocol):
    """What a robot's own controller may know of its M bodies at a step: twist and attitude, no place.

    `velocity_b` and `angular_b` (M, 3) [m/s, rad/s] in the body frame, and
    `roll_pitch_yaw` (M, 3) [rad].
    """

    velocity_b: Array
    angular_b: Array
    roll_pitch_yaw: Array


@dataclass(frozen=True)
class WheelLayout:
    """Rolling radius [m], the track that tells a difference of wheels as a turn [m], and which are where.

    `left` and `right` are indices of motors.
    """

    radius_m: float
    track_m: float
    left: tuple[int, ...]
    right: tuple[int, ...]


class Robot(Protocol):
    """M robots of a kind, driven by actions.

    Frame: x forward, y left, z up; the origin is that of the URDF's base link,
    `standing_height_m` above level ground. `length_m`, `width_m` and
    `height_m` are those of the box round it, which the origin is amid, seen
    from above. `contact_centres_b` (N, 3) [m] are the middles of the balls of
    `contact_radius_m` that it stands on, wheels or feet `contact_width_m` wide,
    in the order of `body.ground_links`; wheels are those of the first motors. `wheels` is None for
    what walks; `mounts` is where sensors stand, `battery` what feeds the motors.
    """

    length_m: float
    width_m: float
    height_m: float
    standing_height_m: float
    contact_radius_m: float
    contact_width_m: float
    mass_kg: float
    body: RobotBody
    mounts: MountsConf
    battery: BatteryConf

    @property
    def contact_centres_b(self) -> Array:
        """Middles (N, 3) [m] of the wheels or feet, where it is put down."""
        ...

    @property
    def wheels(self) -> WheelLayout | None:
        """How its wheels' turns are told as a motion; None where it has no wheels."""
        ...

    @property
    def max_speed_mps(self) -> float:
        """Largest speed that can be commanded."""
        ...

    @property
    def footprint_radius_m(self) -> float:
        """Radius of the circle round the origin that holds the robot at any yaw."""
        ...

    def outline(self) -> Array:
        """Points (P, 2) round the hull in the body frame [m], at most 0.16 m apart, seen from above."""
        ...

    def action_bounds(self) -> tuple[Array, Array]:
        """Lowest and highest action, each (A,); `speed_and_heading_bounds` are those of most."""
        ...

    def rest_action(self) -> Array:
        """The action (A,) that has it stand still."""
        ...

    def reset(self, mask: Flags) -> None:
        """Stand still and forget the past in the scenes in `mask` (M,)."""
        ...

    def commands(self, action: Array, motion: BodyMotion, step_s: float) -> Array:
        """A command for each motor, (M, J): a speed [rad/s] or an angle [rad], as `Motor.mode` says.

        `action` (M, A); what exceeds the bounds is clipped. It is called once a
        control step of `step_s`, in order.
        """
        ...


def speed_and_heading_bounds(max_speed_mps: float) -> tuple[Array, Array]:
    """Bounds, each (2,), of a speed [m/s] and a heading relative to the present one [rad]."""
    high = np.array([max_speed_mps, np.pi])
    return -high, high


class RectangularHull:
    """What follows of a hull that is a rectangle about the origin, seen from above."""

    length_m: float
    width_m: float

    @property
    def footprint_radius_m(self) -> float:
        """Radius of the circle round the origin that holds the robot at any yaw."""
        return float(np.hypot(self.length_m / 2, self.width_m / 2))

    def outline(self) -> Array:
        """Points (P, 2) round the hull in the body frame [m], at most 0.16 m apart, seen from above."""
        return rectangle_outline(self.length_m, self.width_m)


def rectangle_outline(length_m: float, width_m: float, apart_m: float = 0.16) -> Array:
    """Points (P, 2) [m] round a rectangle about the origin, at most `apart_m` from their neighbours."""
    x, y = length_m / 2, width_m / 2
    ahead = np.linspace(-x, x, max(5, int(np.ceil(length_m / apart_m)) + 1))
    across = np.linspace(-y, y, max(5, int(np.ceil(width_m / apart_m)) + 1))[1:-1]
    sides = [np.column_stack([ahead, np.full(len(ahead), side)]) for side in (-y, y)]
    ends = [np.column_stack([np.full(len(across), end), across]) for end in (-x, x)]
    return np.concatenate([*sides, *ends])
