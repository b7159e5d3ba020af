"""The behaviour `flee`: stands, and runs away from robots, or from members of a group, that come near."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.ranges import Speed, Who
from dune_rl.behaviours.steering import SteeredBehaviour, nearest_of
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

# Time in which a pursuer's place is predicted [s].
_PREDICTION_S = 1.0
# Who flees goes on until the pursuer is this much farther away than where it began.
_RELIEF = 1.5
# Walls are left to the side when they are this near [m].
_WALL_M = 1.5


class Flee(SteeredBehaviour):
    """Flees from the nearest of those called `target` within `range_m`, until it is 1.5 times as far away.

    Evasion after Reynolds, "Steering behaviors for autonomous characters" (1999): straight away from where
    the pursuer will be in a second. Beside obstacles it flees along them.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        target: Who = "robots",
        speed_mps: Speed = 1.5,
        range_m: Annotated[float, Field(gt=0.0, le=100.0, description="how near lets it flee [m]")] = 3.0,
    ) -> None:
        super().__init__(num_rows, speed_mps)
        self._target, self._range_m = target, range_m
        self._flees = np.zeros(num_rows, bool)

    def want(self, state: State, group: GroupState) -> Array:
        """Away from the pursuer, along obstacles."""
        place, velocity, _, distance = nearest_of(state, group, self._target)
        reach = np.where(self._flees & ~self._fresh, _RELIEF, 1.0) * self._range_m
        self._flees = distance < reach
        away, _ = unit_vectors(group.motion.position_w[:, :2] - place - _PREDICTION_S * velocity)
        gap, wall = (
            values.reshape(self._num_rows, -1) for values in state.surroundings.obstacles(group.name)
        )
        into = np.maximum((away * wall).sum(axis=1), 0.0)
        nearness = np.clip(1.0 - (gap[:, 0] - group.body.reach_m) / _WALL_M, 0.0, 1.0)
        along, length = unit_vectors(away - (nearness * into)[:, None] * wall)
        # Straight at a wall neither side is better: the one on the left.
        left = np.stack([-wall[:, 1], wall[:, 0]], axis=1)
        course = np.where((length < 0.2)[:, None], left, along)
        self.face(self._flees, place, group)
        return course * np.where(self._flees, self._speed_mps, 0.0)[:, None]
