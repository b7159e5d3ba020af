"""The behaviour `follow`: walks after the nearest robot, or after members of a group, on their trail."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.ranges import Speed, Who
from dune_rl.behaviours.steering import SteeredBehaviour, nearest_of
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

# Points of the trail, their spacing [m], and how near a follower has to come to one [m].
_TRAIL = 64
_SPACING_M = 0.5
_NEAR_M = 0.6
# Time in which it would close the gap [s].
_RELAXATION_S = 0.5


class Follow(SteeredBehaviour):
    """Follows the leader, which is the nearest of those called `target`, and stands `distance_m` from it.

    Leader following with arrival, after Reynolds, "Steering behaviors for autonomous characters" (1999): the
    speed is the distance beyond `distance_m` over 0.5 s. It walks on the leader's trail of the last 32 m, and
    so round the obstacles that the leader went round. The leader is chosen at the start of an episode, or
    when somebody comes, and again when it leaves the scene.
    """

    motion_models = ("holonomic", "unicycle", "bicycle")

    def __init__(
        self,
        num_rows: int,
        *,
        target: Who = "robots",
        speed_mps: Speed = 1.0,
        distance_m: Annotated[
            float, Field(gt=0.0, le=100.0, description="gap between the centres [m]")
        ] = 1.5,
    ) -> None:
        super().__init__(num_rows, speed_mps)
        self._target, self._distance_m = target, distance_m
        self._leader = np.zeros(num_rows, np.int64)
        self._trail = np.zeros((num_rows, _TRAIL, 2))
        self._next, self._laid = np.zeros((2, num_rows), np.int64)

    def want(self, state: State, group: GroupState) -> Array:
        """Along the trail, at a speed that falls as the gap closes."""
        around, rows = state.surroundings, np.arange(self._num_rows)
        here, scenes = group.motion.position_w[:, :2], rows // group.count
        alone = around.columns(group.name).start + rows % group.count
        self._fresh = self._fresh | ~around.are_here[scenes, self._leader] | (self._leader == alone)
        if self._fresh.any():
            self._choose_leaders(state, group)
        leader = around.position_w[scenes, self._leader]
        is_fresh = self._fresh
        self._next[is_fresh], self._laid[is_fresh] = 0, 0
        last = self._trail[rows, (self._laid - 1) % _TRAIL]
        lays = (self._laid == 0) | (np.hypot(*(leader - last).T) > _SPACING_M)
        self._trail[rows[lays], self._laid[lays] % _TRAIL] = leader[lays]
        self._laid = self._laid + lays
        # A full trail loses its oldest point; what is reached is left behind.
        self._next = np.maximum(self._next, self._laid - _TRAIL)
        point = self._trail[rows, self._next % _TRAIL]
        is_reached = (np.hypot(*(point - here).T) < _NEAR_M) & (self._next < self._laid)
        self._next = self._next + is_reached
        goal = np.where((self._next < self._laid)[:, None], self._trail[rows, self._next % _TRAIL], leader)
        gap = np.hypot(*(leader - here).T) - self._distance_m
        speed = np.clip(gap / _RELAXATION_S, 0.0, self._speed_mps)
        self.face(np.hypot(*(leader - here).T) > 0.0, leader, group)
        return unit_vectors(goal - here)[0] * speed[:, None]

    def _choose_leaders(self, state: State, group: GroupState) -> None:
        around = state.surroundings
        leader, _, _, distance = nearest_of(state, group, self._target)
        scenes = np.arange(self._num_rows) // group.count
        apart = np.linalg.norm(around.position_w[scenes] - leader[:, None], axis=-1)
        apart[~(around.are_of(self._target) & around.are_here[scenes])] = np.inf
        alone = around.columns(group.name).start + np.arange(self._num_rows) % group.count
        chosen = np.where(np.isfinite(distance), apart.argmin(axis=1), alone)
        self._leader = np.where(self._fresh, chosen, self._leader)
