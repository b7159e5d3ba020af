"""Timed way-points of an actor that a world's file brings along."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ActorTrajectory:
    """Poses of an actor over time, linear between its way-points.

    `times` (T,) [s] rise strictly from 0, `poses` (T, 4) are x, y, z [m] and yaw [rad], which may be beyond
    [-pi, pi) so that turns are the shorter ones. The actor stands at its first pose for `delay_s`. After the
    last way-point it stays there or, with `loop`, begins anew with the delay. `on_ground` says that it walks
    on the ground whatever z is.
    """

    name: str
    times: Array
    poses: Array
    loop: bool = True
    delay_s: float = 0.0
    on_ground: bool = True

    @property
    def duration_s(self) -> float:
        """Time from the first to the last way-point [s]."""
        return float(self.times[-1])
