"""The behaviour `go_to_goal`: turn toward the goal, then drive straight at it, without avoiding obstacles."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.state import GroupState, State

Speed = Annotated[float, Field(gt=0.0, le=50.0, description="speed toward the goal [m/s]")]


class GoToGoal:
    """Actions (N, 2): a speed [m/s] and the heading of the goal relative to the present one [rad].

    The speed is the share of `speed_mps` that points at the goal; bodies do not exceed their own top speed.
    """

    def __init__(self, num_rows: int, *, speed_mps: Speed = 1.0) -> None:
        self._speed_mps = speed_mps

    def reset(self, mask: NDArray[np.bool_], group: GroupState) -> None:
        """Nothing is remembered."""

    def act(self, state: State, group: GroupState) -> NDArray[np.float64]:
        """Head for the goal."""
        bearing = group.goal.bearing
        return np.stack([self._speed_mps * np.maximum(np.cos(bearing), 0.0), bearing], axis=1)
