"""What rewards, terminations and metrics may know of a moment: a frozen picture of the batch."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Snapshot:
    """The M rovers after a control step; every array has the leading axis M.

    What a term must remember is a field of its own (`previous_goal_distance`,
    `steps_since_moved`), so that terms stay pure functions.
    """

    position_w: Array
    """Of the chassis centre [m], (M, 3)."""
    roll_pitch_yaw: Array
    """Attitude [rad], (M, 3)."""
    tilt: Array
    """Angle between the body's z and the world's [rad], (M,)."""
    speed: Array
    """Forward speed in the body frame [m/s], (M,)."""
    angular_b: Array
    """Angular velocity in the body frame [rad/s], (M, 3)."""
    acceleration_b: Array
    """Acceleration of the IMU in the body frame, gravity left out [m/s²], (M, 3)."""
    goal_distance: Array
    """Horizontal distance to the goal [m], (M,)."""
    previous_goal_distance: Array
    """The same one control step before [m], (M,)."""
    goal_heading: Array
    """Bearing of the goal from the rover's heading [rad], in [-pi, pi), (M,)."""
    clearance: Array
    """Distance from the hull to the nearest obstacle or actor [m], (M,); 0 on contact, inf without any."""
    new_collisions: NDArray[np.int64]
    """Encounters that began in this step, (M,)."""
    touching: Flags
    """Whether the rover touches anything but the ground, (M,)."""
    steps: NDArray[np.int64]
    """Control steps since the episode began, (M,)."""
    steps_since_moved: NDArray[np.int64]
    """Control steps since the rover last left a circle of the stuck radius, (M,)."""
    out_of_world: Flags
    """Whether the rover has left the terrain, (M,)."""
    diverged: Flags
    """Whether physics gave a state that cannot be, (M,)."""
