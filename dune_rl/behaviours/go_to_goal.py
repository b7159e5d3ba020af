"""The behaviour `go_to_goal`: turn toward the goal, then drive straight at it, without avoiding obstacles."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.state import GroupState, State

Speed = Annotated[float, Field(gt=0.0, le=50.0, description="speed toward the goal [m/s]")]


# A goal that is this much outside of the tightest curve is in reach of a turn.
_MARGIN = 1.1
# Bodies that cannot turn on the spot turn towards the goal at this share of their speed.
_TURNING_SHARE = 0.3


class GoToGoal:
    """Actions (N, 2): a speed [m/s] and the heading of the goal relative to the present one [rad].

    The speed is the share of `speed_mps` that points at the goal; bodies do not exceed their own top speed.
    A body that cannot turn on the spot keeps moving; while the goal lies inside its tightest curve, which it
    would circle for ever, it drives straight on until it does not (Dubins 1957).
    """

    def __init__(self, num_rows: int, *, speed_mps: Speed = 1.0) -> None:
        self._speed_mps = speed_mps

    def reset(self, mask: NDArray[np.bool_], group: GroupState) -> None:
        """Nothing is remembered."""

    def act(self, state: State, group: GroupState) -> NDArray[np.float64]:
        """Head for the goal."""
        bearing = group.goal.bearing
        least = _TURNING_SHARE if group.turning_radius_m else 0.0
        speed = self._speed_mps * np.maximum(np.cos(bearing), least)
        if group.turning_radius_m:
            across = 2.0 * _MARGIN * group.turning_radius_m * np.abs(np.sin(bearing))
            bearing = np.where(group.goal.distance < across, 0.0, bearing)
        return np.stack([speed, bearing], axis=1)
