"""The behaviour `go_to_goal`: turn toward the goal, then drive straight at it, without avoiding obstacles."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.state import GroupState, State

Speed = Annotated[float, Field(gt=0.0, le=50.0, description="speed toward the goal [m/s]")]


# A turn begins when the goal is outside of the tightest curve by the first factor, and ends when it is
# inside by the second.
_OUTSIDE, _INSIDE = 1.1, 0.92
# Bodies that cannot turn on the spot turn towards the goal at this share of their speed.
_TURNING_SHARE = 0.5


class GoToGoal:
    """Actions (N, 2): a speed [m/s] and the heading of the goal relative to the present one [rad].

    The speed is the share of `speed_mps` that points at the goal; bodies do not exceed their own top speed.
    A body that cannot turn on the spot keeps moving; while the goal lies inside its tightest curve, which it
    would circle for ever, it drives straight on until it does not (Dubins 1957).
    """

    def __init__(self, num_rows: int, *, speed_mps: Speed = 1.0) -> None:
        self._speed_mps = speed_mps
        self._turns = np.ones(num_rows, bool)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """The agents in `mask` (N,) may turn at once."""
        self._turns = self._turns | mask

    def act(self, state: State, group: GroupState) -> Array:
        """Head for the goal."""
        bearing, distance = group.goal.bearing, group.goal.distance
        radius, rear = group.body.turning_radius_m, group.body.rear_axle_m
        speed = self._speed_mps * np.maximum(np.cos(bearing), _TURNING_SHARE if radius else 0.0)
        if radius:
            # Distances of the goals from the middles of the tightest curves towards them, over their radius.
            ahead = distance * np.cos(bearing) + rear
            aside = distance * np.abs(np.sin(bearing)) - radius
            share = np.hypot(ahead, aside) / np.hypot(radius, rear)
            self._turns = np.where(self._turns, share >= _INSIDE, share >= _OUTSIDE)
            bearing = np.where(self._turns, bearing, 0.0)
        return np.stack([speed, bearing], axis=1)
