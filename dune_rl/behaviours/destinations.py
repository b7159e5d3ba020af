"""Ways of actors without a task: places in turn, or random ones; `random_waypoint` and `patrol`."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.behaviours.steering import PauseRange, Range, Speed, SteeredBehaviour, draws_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State
from dune_rl.state.surroundings import EDGE_M

# Random places that are looked at, points on the way to each, and the shortest way.
_CANDIDATES = 24
_LOOKS = 24
_SHORTEST_M = 2.0
# Room beside the body on the way [m].
_ROOM_M = 0.15
_MAX_RISE = np.tan(np.radians(25.0))
_SLOPE_PROBES = 0.3 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Who has come no nearer for so long goes elsewhere.
_PATIENCE_S = 4.0
_NEARER_M = 0.1
# A target is reached within this distance, and agents slow down within that [m].
_NEAR_M = 0.4
_SLOW_M = 0.8
_PATROL_RANGE_M = 1_000.0


def _rise(state: State, points: Array, scenes: NDArray[np.int64]) -> Array:
    """Tangent of the ground's slope, (m, ...), at points (m, ..., 2) of `scenes` (m,)."""
    heights = state.ground.height(points[..., None, :] + _SLOPE_PROBES, scenes)
    rises = np.stack([heights[..., 0] - heights[..., 1], heights[..., 2] - heights[..., 3]], axis=-1)
    return np.asarray(np.linalg.norm(rises, axis=-1) / (2.0 * _SLOPE_PROBES[0, 0]))


class DestinedBehaviour(SteeredBehaviour):
    """A behaviour that goes to `places` (P, 2) [m] in turn, or to random ones, and pauses on arrival.

    Robots go to the goals of their task. Member k of a group begins at place k. Random places are within
    `range_m` of where the agent started, to the sides; the straight way there is free of obstacles and not
    steeper than 25 degrees, or the agent goes as far as that. An agent that gets no nearer for 4 s takes the
    next one. `stream_name` is that of the random draws.
    """

    stream_name: str

    def __init__(
        self,
        num_rows: int,
        speed_mps: float,
        places: Sequence[tuple[float, float]],
        range_m: float,
        pause_s: tuple[float, float],
    ) -> None:
        super().__init__(num_rows, speed_mps)
        self._places, self._range_m = np.array(places, float).reshape(-1, 2), range_m
        self._pause_s = pause_s
        self._target_w, self._home_w = np.zeros((2, num_rows, 2))
        self._pause_left_s, self._since_nearer_s, self._nearest_m = np.zeros((3, num_rows))
        self._arrived = np.zeros(num_rows, bool)
        self._turn = np.zeros(num_rows, np.int64)

    def targets(self, state: State, group: GroupState) -> tuple[Array, Flags]:
        """Where the agents go now, (N, 2) [m], and which of them pause, (N,)."""
        if group.body.is_robot:
            return group.goal.position_w, np.zeros(self._num_rows, bool)
        fresh, near_m = self._fresh, max(_NEAR_M, self.context.vehicle.turning_radius_m)
        position, step_s = group.motion.position_w[:, :2], group.episode.step_s
        if fresh.any():
            self._home_w = np.where(fresh[:, None], position, self._home_w)
            self._pause_left_s[fresh] = self._since_nearer_s[fresh] = 0.0
            self._arrived = self._arrived & ~fresh
            self._turn = np.where(fresh, np.arange(len(fresh)) % group.count, self._turn)
        distance = np.hypot(*(self._target_w - position).T)
        nearer = distance < self._nearest_m - _NEARER_M
        self._nearest_m = np.where(nearer, distance, self._nearest_m)
        self._since_nearer_s = np.where(nearer | self._arrived, 0.0, self._since_nearer_s + step_s)
        arrives = ~fresh & ~self._arrived & (distance < near_m)
        for row in np.flatnonzero(arrives).tolist():
            self._pause_left_s[row] = 0.0
            if self._pause_s[1] > 0.0:
                draws = draws_of(f"{self.stream_name} pause", group, row)
                self._pause_left_s[row] = draws.uniform(*self._pause_s)
        self._pause_left_s = np.maximum(self._pause_left_s - step_s * self._arrived, 0.0)
        self._arrived = self._arrived | arrives
        leaves = self._arrived & (self._pause_left_s <= 0.0)
        gives_up = self._since_nearer_s > _PATIENCE_S
        chooses = (fresh | leaves | gives_up) & ~group.done
        if chooses.any():
            self._choose(np.flatnonzero(chooses), state, group)
        return self._target_w, self._arrived

    def _choose(self, rows: NDArray[np.int64], state: State, group: GroupState) -> None:
        """Set the targets of `rows` (m,)."""
        self._target_w = self._target_w.copy()
        position = group.motion.position_w[rows, :2]
        if len(self._places):
            self._turn[rows] += ~self._fresh[rows]
            self._target_w[rows] = self._places[self._turn[rows] % len(self._places)]
        else:
            self._target_w[rows] = self._random_places(rows, state, group)
        self._nearest_m[rows] = np.hypot(*(self._target_w[rows] - position).T)
        self._since_nearer_s[rows] = 0.0
        self._arrived[rows] = False

    def _random_places(self, rows: NDArray[np.int64], state: State, group: GroupState) -> Array:
        """Places (m, 2) [m], straight ahead of which nothing is."""
        reach_m = group.body.reach_m
        here, scenes = group.motion.position_w[rows, None, :2], rows // group.count
        shares = np.stack(
            [draws_of(self.stream_name, group, row).random((_CANDIDATES, 2)) for row in rows.tolist()]
        )
        xmin, xmax, ymin, ymax = state.ground.extents[scenes].T[..., None]
        low, high = np.stack([xmin, ymin], axis=-1), np.stack([xmax, ymax], axis=-1)
        places = self._home_w[rows, None] + (2.0 * shares - 1.0) * self._range_m
        places = np.clip(places, low + EDGE_M + reach_m, high - EDGE_M - reach_m)
        way = places - here
        ends = np.linspace(0.0, 1.0, _LOOKS)
        points = here[:, :, None] + ends[:, None] * way[:, :, None]
        length = np.linalg.norm(way, axis=-1)
        clearance = state.ground.clearance(points, scenes)
        free = clearance >= np.minimum(reach_m + _ROOM_M, clearance[..., :1])
        free[..., 1:] &= (_rise(state, points, scenes) <= _MAX_RISE)[..., 1:]
        # How far each way is free: up to the last point before the first that is not.
        reached = np.cumprod(free, axis=-1).sum(axis=-1) - 1
        is_good = (reached == _LOOKS - 1) & (length >= _SHORTEST_M)
        gone = np.maximum(reached, 0) / (_LOOKS - 1) * length
        choice = np.where(is_good.any(axis=1), is_good.argmax(axis=1), gone.argmax(axis=1))
        every = np.arange(len(rows))
        found: Array = points[every, choice, np.maximum(reached[every, choice], 0)]
        return found

    def want(self, state: State, group: GroupState) -> Array:
        """Straight to the target, and slowly on arrival; not at all in a pause."""
        target, pauses = self.targets(state, group)
        return self.arrive(target, np.where(pauses, 0.0, self._speed_mps), group)

    def arrive(self, target_w: Array, speed_mps: Array, group: GroupState) -> Array:
        """Velocities (N, 2) to `target_w` (N, 2), at `speed_mps` (N,) until short of it (Reynolds 1999)."""
        direction, distance = unit_vectors(target_w - group.motion.position_w[:, :2])
        return direction * (speed_mps * np.minimum(distance / _SLOW_M, 1.0))[:, None]


class RandomWaypoint(DestinedBehaviour):
    """Goes straight to a random place within `range_m` of where it started, pauses, and goes to the next one.

    The mobility model of Johnson & Maltz, "Dynamic source routing in ad hoc wireless networks" (1996), of one
    speed, with ways that are free of obstacles, and past everybody.
    """

    stream_name = "random_waypoint"
    motion_models = ("holonomic", "unicycle", "bicycle")

    def __init__(
        self, num_rows: int, *, speed_mps: Speed = 1.0, range_m: Range = 8.0, pause_s: PauseRange = (0.0, 3.0)
    ) -> None:
        super().__init__(num_rows, speed_mps, (), range_m, pause_s)


class Patrol(DestinedBehaviour):
    """Goes to `places` in turn, straight and past everybody, waits at each, and begins again after the last.

    Member k of the group begins at place k, so that members are spread. A place that cannot be reached,
    because something stands in the straight way, is left out after 4 s without progress.
    """

    stream_name = "patrol"
    motion_models = ("holonomic", "unicycle", "bicycle")

    def __init__(
        self,
        num_rows: int,
        *,
        places: Annotated[
            tuple[tuple[float, float], ...], Field(min_length=2, description="points [x, y] in turn [m]")
        ],
        speed_mps: Speed = 1.0,
        wait_s: PauseRange = (2.0, 2.0),
    ) -> None:
        super().__init__(num_rows, speed_mps, places, _PATROL_RANGE_M, wait_s)
