"""Distances and bearings of goals from step to step."""

import numpy as np

from dune_rl.env.starts.source import StartSource
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.state.state import GoalState, Motion


class GoalTracker:
    """Tracks the distance and bearing of N agents' goals from step to step."""

    def __init__(self, source: StartSource, num_rows: int) -> None:
        self.source = source
        self._distance = np.zeros(num_rows)
        self.latest = GoalState(source.goals_w, self._distance, self._distance, self._distance)

    def begin(self, mask: Flags, motion: Motion) -> GoalState:
        """The goals at the start of the episodes in `mask` (N,)."""
        distance, bearing = self._polar(motion)
        self._distance = np.where(mask, distance, self._distance)
        self.latest = GoalState(self.source.goals_w, distance, self._distance, bearing)
        return self.latest

    def measure(self, motion: Motion) -> GoalState:
        """The goals after a control step; call it once a step."""
        previous = self._distance
        self._distance, bearing = self._polar(motion)
        self.latest = GoalState(self.source.goals_w, self._distance, previous, bearing)
        return self.latest

    def renew(self, mask: Flags, motion: Motion, now: GoalState) -> GoalState:
        """Renew the goals of the agents in `mask` (N,) and return the updated state."""
        if not mask.any():
            return now
        self.source.renew(mask)
        self._distance, bearing = self._polar(motion)
        return GoalState(self.source.goals_w, self._distance, now.previous_distance, bearing)

    def _polar(self, motion: Motion) -> tuple[Array, Array]:
        offset = self.source.goals_w - motion.position_w[:, :2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        return distance, wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - motion.yaw)
