"""Energy that a robot draws from its battery."""

from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array

_JOULES_PER_WH = 3600.0


class BatteryConf(Settings):
    """Capacity, power at rest, and efficiency of the motors: mechanical over electrical work.

    Braking recovers nothing.
    """

    capacity_wh: float = Field(gt=0.0, description="energy of a full battery [W h]")
    idle_w: float = Field(10.0, ge=0.0)
    efficiency: float = Field(0.7, gt=0.0, le=1.0)

    def drawn_wh(self, work_j: Array, time_s: float) -> Array:
        """Energy drawn [W h], (N,), in `time_s` in which the motors do mechanical work `work_j` (N,) [J]."""
        return (self.idle_w * time_s + work_j / self.efficiency) / _JOULES_PER_WH
