"""What a sensor is, and what there is to be sensed."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]
Reading = NDArray[Any]
# Forward, left and up of the robot's origin [m]; None is where the robot carries such a sensor.
Mount = tuple[float, float, float] | None
# Lowest and highest value of every entry of a reading, in its own shape and type.
Bounds = tuple[Reading, Reading]
# The smallest float32 that no angle in [-pi, pi] exceeds.
PI32 = np.nextafter(np.float32(np.pi), np.float32(4.0))


def place_b(mount: Mount) -> Array:
    """Where a sensor stands in the body frame [m], (3,): at the origin, if no robot gives it a place."""
    return np.zeros(3) if mount is None else np.asarray(mount, np.float64)


@dataclass(frozen=True)
class Wheels:
    """Angle [rad], speed [rad/s] and torque [N m] of the W drive joints, each (M, W).

    Positive rolls the rover forward. Angles count whole turns; torques are the
    drives' own, of the last physics step.
    """

    angle: Array
    speed: Array
    torque: Array


@dataclass(frozen=True)
class Moment:
    """The rovers' true motion, and where the actors are, at one instant of M scenes.

    `position_w`, `velocity_w` and `angular_w` (M, 3) [m, m/s, rad/s] are the
    body's in the world frame, `velocity_b` and `angular_b` in its own,
    `rotation` (M, 3, 3) turns body to world, `roll_pitch_yaw` (M, 3) [rad];
    `actor_poses` (M, K, 4) are x, y, z on the ground and yaw. What is random
    in a sensor depends on `seed`, `episodes` (M,) and `steps` (M,) alone: how
    many control steps each episode has had. `wheels` is there where a sensor
    has `needs_wheels`.
    """

    position_w: Array
    rotation: Array
    velocity_w: Array
    angular_w: Array
    velocity_b: Array
    angular_b: Array
    roll_pitch_yaw: Array
    actor_poses: Array
    seed: int
    episodes: Counts
    steps: Counts
    wheels: Wheels | None = None


def wheels_of(now: Moment) -> Wheels:
    """What `now` tells of the wheels, for a sensor that has `needs_wheels`."""
    if now.wheels is None:
        raise ValueError("the moment tells nothing of wheels; give the sensor `needs_wheels = True`")
    return now.wheels


class Sensor(Protocol):
    """An instrument on each of M rovers, with one or more readings by name.

    One that reads a moment's `wheels` has a further attribute, `needs_wheels`, which is true.
    """

    def bounds(self) -> dict[str, Bounds]:
        """Lowest and highest values of each reading, for one rover."""
        ...

    def begin(self, mask: Flags, now: Moment) -> None:
        """Read at the start of the episodes in `mask` (M,), which have no past; the others read on."""
        ...

    def measure(self, now: Moment) -> None:
        """Read at the end of a control step, once."""
        ...

    def read(self) -> dict[str, Reading]:
        """The readings, each (M, ...); asking twice gives the same."""
        ...
