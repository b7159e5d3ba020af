"""Where robots carry their sensors."""

import numpy as np
from pydantic import Field

from dune_rl.settings import Settings

Triple = tuple[float, float, float]


class MountsConf(Settings):
    """Forward, left and up of the robot's origin [m]: scanners and depth strip, camera, and inertial unit.

    A sensor whose own `mount_b` is null stands here.
    """

    scanner_b: Triple = (0.174, 0.0, 0.196)
    camera_b: Triple = (0.2, 0.0, 0.175)
    camera_pitch_rad: float = Field(0.0, ge=-np.pi / 2, le=np.pi / 2)
    imu_b: Triple = (0.0, 0.0, 0.096)
