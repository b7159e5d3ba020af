"""What is constant of the bodies of a group."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class BodyDescription:
    """The constants of a group's bodies, which are equal.

    `kind` is their class, such as robot, person or vehicle; `is_robot` marks bodies that physics simulates.
    `radius_m` is half the width, and `half_length_m` half the length. `reach_m` is the radius of a disc that
    holds the outline; `height_m` is above the ground. `wheel_radius_m` is None without driven wheels.
    `turning_radius_m` is the radius of the tightest curve of bodies that cannot turn on the spot, 0 for all
    other bodies; a rear axle runs on it, `rear_axle_m` behind the origin. `avoids` is False for bodies that
    are moved along paths, and give way to nobody. `max_water_m` is the deepest water that kinematic bodies
    cross, None for robots.
    """

    kind: str = "robot"
    is_robot: bool = False
    radius_m: float = 0.0
    half_length_m: float = 0.0
    reach_m: float = 0.0
    height_m: float = 0.0
    wheel_radius_m: float | None = None
    turning_radius_m: float = 0.0
    rear_axle_m: float = 0.0
    avoids: bool = True
    max_water_m: float | None = None

    @property
    def disc_offsets_m(self) -> tuple[float, ...]:
        """Where discs of `radius_m` cover the body, forward of its origin [m]."""
        farthest = self.half_length_m - self.radius_m
        if farthest <= 0.0:
            return (0.0,)
        number = math.ceil(farthest / max(self.radius_m, 0.05)) + 1
        return tuple(farthest * (2.0 * disc / (number - 1) - 1.0) for disc in range(number))
