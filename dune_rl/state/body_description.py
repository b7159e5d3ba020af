"""What is constant of the bodies of a group."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BodyDescription:
    """The constants of a group's bodies, which are equal.

    `kind` is their class, such as robot, person or vehicle; `is_robot` marks bodies that physics simulates.
    `radius_m` is the radius of the circle that approximates a body in distances between agents: half the
    width. `reach_m` is the radius of a disc that holds the outline; `height_m` is above the ground.
    `wheel_radius_m` is None without driven wheels. `turning_radius_m` is the radius of the tightest curve of
    bodies that cannot turn on the spot, 0 for all other bodies; a rear axle runs on it, `rear_axle_m` behind
    the origin. `avoids` is False for bodies that are moved along paths, and give way to nobody. `max_water_m`
    is the deepest water that kinematic bodies cross, None for robots.
    """

    kind: str = "robot"
    is_robot: bool = False
    radius_m: float = 0.0
    reach_m: float = 0.0
    height_m: float = 0.0
    wheel_radius_m: float | None = None
    turning_radius_m: float = 0.0
    rear_axle_m: float = 0.0
    avoids: bool = True
    max_water_m: float | None = None
