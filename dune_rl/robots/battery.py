"""What a robot takes from its battery."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.settings import Settings

Array = NDArray[np.float64]


class BatteryConf(Settings):
    """Capacity, what is drawn with the motors still, and the share of what motors draw that turns joints.

    Braking gives nothing back.
    """

    capacity_wh: float = Field(gt=0.0)
    idle_w: float = Field(10.0, ge=0.0)
    efficiency: float = Field(0.7, gt=0.0, le=1.0)


def power_w(conf: BatteryConf, speeds: Array, torques: Array, gear_friction_nm: Array) -> Array:
    """Power drawn [W], (M,), with joints' speeds [rad/s] and torques [N m], (M, J).

    Torques are what turns the joints, so that `gear_friction_nm` (J,) comes on top.
    """
    turning = torques * speeds + gear_friction_nm * np.abs(speeds)
    drawn: Array = conf.idle_w + np.maximum(turning, 0.0).sum(axis=1) / conf.efficiency
    return drawn
