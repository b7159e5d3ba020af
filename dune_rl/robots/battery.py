"""What a robot takes from its battery."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.settings import Settings

Array = NDArray[np.float64]
_JOULES_PER_WH = 3600.0


class BatteryConf(Settings):
    """Capacity, what is drawn with the motors still, and the share of what motors draw that turns joints.

    Braking gives nothing back.
    """

    capacity_wh: float = Field(gt=0.0)
    idle_w: float = Field(10.0, ge=0.0)
    efficiency: float = Field(0.7, gt=0.0, le=1.0)

    def drawn_wh(self, work_j: Array, time_s: float) -> Array:
        """Energy drawn [W h], (M,), while motors have done `work_j` (M,) [J] in `time_s`."""
        return (self.idle_w * time_s + work_j / self.efficiency) / _JOULES_PER_WH
