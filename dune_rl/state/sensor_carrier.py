"""The body that carries the sensors of a group."""

from dataclasses import dataclass
from typing import Protocol

from dune_rl.geometry.arrays import Array
from dune_rl.state.unicycle import Unicycle

Position = tuple[float, float, float]


class WheelMotion(Protocol):
    """What the wheels of a robot tell of its motion, whether it skids (`DriveGeometry`) or steers."""

    @property
    def wheel_radius_m(self) -> float:
        """Rolling radius [m]."""
        ...

    @property
    def track_m(self) -> float:
        """Distance [m] of the sides, by which bounds of the yaw rate follow from those of wheels."""
        ...

    @property
    def num_wheels(self) -> int:
        """Number of wheels with motors, whose joints are the first ones."""
        ...

    def motion(self, turned: Array, angles: Array) -> Array:
        """Way ahead [m] and turn [rad] of M robots, (M, 2).

        `turned` (M, W) [rad] is how far the wheels have turned meanwhile, and `angles` (M, J) [rad] are those
        of all motors' joints.
        """
        ...


@dataclass(frozen=True)
class SensorCarrier:
    """The body that carries the sensors of a group.

    `scanner_b`, `camera_b` and `imu_b` are where it carries scanners, cameras and the inertial unit (forward,
    left and up of its origin [m]), for sensors without a mount of their own; `camera_pitch_deg` tilts cameras
    down. Its origin is `standing_height_m` above level ground. `num_joints` counts the joints of its driven
    wheels, or of its legs, and `drive` is the geometry of its wheels, None without wheels. `max_speed_mps` is
    its top speed, `vehicle` the model of a body that is driven by speed and heading.
    """

    scanner_b: Position
    camera_b: Position
    imu_b: Position
    camera_pitch_deg: float = 0.0
    standing_height_m: float = 0.0
    max_speed_mps: float = 10.0
    num_joints: int = 0
    drive: WheelMotion | None = None
    vehicle: Unicycle | None = None
