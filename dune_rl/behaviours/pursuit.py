"""The behaviours `follow`, `flee` and `crossing`: toward, away from and across the way of other agents."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.steering import Speed, SteeredBehaviour, Who, nearest_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

# Points of the trail, their spacing [m], and how near a follower has to come to one [m].
_TRAIL = 64
_SPACING_M = 0.5
_NEAR_TRAIL_M = 0.6
# Time in which it would close the gap [s].
_RELAXATION_S = 0.5
# Time in which a pursuer's place is predicted [s].
_PREDICTION_S = 1.0
# Who flees goes on until the pursuer is this much farther away than where it began.
_RELIEF = 1.5
# Walls are left to the side when they are this near [m].
_WALL_M = 1.5
# A slower robot is standing: nothing crosses its way [m/s].
_STANDS_MPS = 0.05
# Who is this near to the place to cross the line at, and changes its side, has crossed it [m].
_NEAR_LINE_M = 0.5


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
        distance_m: Annotated[float, Field(gt=0.0, le=100.0, description="between centres [m]")] = 1.5,
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
        is_reached = (np.hypot(*(point - here).T) < _NEAR_TRAIL_M) & (self._next < self._laid)
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
        around = state.surroundings.obstacles(group.name)
        gap, wall = (values.reshape(self._num_rows, -1) for values in around)
        into = np.maximum((away * wall).sum(axis=1), 0.0)
        nearness = np.clip(1.0 - (gap[:, 0] - group.body.reach_m) / _WALL_M, 0.0, 1.0)
        along, length = unit_vectors(away - (nearness * into)[:, None] * wall)
        # Straight at a wall neither side is better: the one on the left.
        left = np.stack([-wall[:, 1], wall[:, 0]], axis=1)
        course = np.where((length < 0.2)[:, None], left, along)
        self.face(self._flees, place, group)
        return course * np.where(self._flees, self._speed_mps, 0.0)[:, None]


class Crossing(SteeredBehaviour):
    """Crosses the line on which the nearest robot drives, `time_to_contact_s` ahead of it, and goes on.

    At p, going at s u, the robot will reach p + s T u in the time to contact T. The actor is on an
    interception course with this moving point, as a missile is (constant bearing): with its place q = p + a u
    + c n, it arrives at the smallest t > 0 that solves (s t + s T - a)² + c² = (w t)², with its own speed w,
    at the velocity (s + (s T - a) / t, -c / t). Behind the line by `beyond_m` it waits until the next robot
    comes within `range_m`. It gives way to other actors, not to robots.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        time_to_contact_s: Annotated[
            float, Field(gt=0.0, le=60.0, description="of the robot with the crossing, on crossing [s]")
        ] = 2.0,
        speed_mps: Speed = 1.0,
        range_m: Annotated[float, Field(gt=0.0, le=1_000.0, description="farther ones are left [m]")] = 10.0,
        beyond_m: Annotated[float, Field(ge=0.0, le=100.0, description="way behind the line [m]")] = 3.0,
    ) -> None:
        super().__init__(num_rows, speed_mps)
        self._ttc_s, self._range_m, self._beyond_m = time_to_contact_s, range_m, beyond_m
        self._side = np.zeros(num_rows)
        self._course = np.zeros((num_rows, 2))
        self._goes_on_m = np.zeros(num_rows)

    def ignored(self, state: State) -> Flags:
        """Robots."""
        return state.surroundings.is_robot

    def want(self, state: State, group: GroupState) -> Array:
        """To the crossing, then on for a while."""
        place, velocity, _, distance = nearest_of(state, group, "robots")
        robot_mps = np.hypot(velocity[:, 0], velocity[:, 1])
        drives = (robot_mps > _STANDS_MPS) & (distance < self._range_m)
        ahead = velocity / np.where(drives, robot_mps, 1.0)[:, None]
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        offset = group.motion.position_w[:, :2] - place
        along, aside = (offset * ahead).sum(axis=1), (offset * left).sum(axis=1)
        own_mps = min(self._speed_mps, self._limit_mps)
        lead = robot_mps * self._ttc_s - along
        time_s = _smallest_root(robot_mps**2 - own_mps**2, 2.0 * robot_mps * lead, lead**2 + aside**2)
        meets = drives & np.isfinite(time_s)
        arrives = meets & (time_s < 1.5 * group.episode.step_s)
        time_s = np.where(meets, np.maximum(time_s, group.episode.step_s), 1.0)
        course = ahead * (robot_mps + lead / time_s)[:, None] - left * (aside / time_s)[:, None]
        self._goes_on_m = np.where(self._fresh, 0.0, self._goes_on_m)
        self._side = np.where(self._fresh, np.sign(aside), self._side)
        # A robot that turns moves its line past those who are elsewhere, too.
        passes = (self._side * aside < 0.0) & (np.abs(lead) < _NEAR_LINE_M)
        crosses = drives & (arrives | passes) & (self._goes_on_m <= 0.0)
        self._goes_on_m = np.where(crosses, self._beyond_m, self._goes_on_m)
        goes_on = self._goes_on_m > 0.0
        across = -left * np.where(self._side > 0.0, own_mps, -own_mps)[:, None]
        self._course = np.where(crosses[:, None], across, self._course)
        self._goes_on_m = self._goes_on_m - own_mps * group.episode.step_s
        self._side = np.where(drives & ~goes_on, np.sign(aside), self._side)
        return np.where(goes_on[:, None], self._course, np.where(meets[:, None], course, 0.0))


def _smallest_root(a: Array, b: Array, c: Array) -> Array:
    """The smallest positive t (N,) with a t² + b t + c = 0; inf where there is none."""
    spread = b * b - 4.0 * a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -0.5 * (b + np.where(b >= 0.0, 1.0, -1.0) * np.sqrt(spread))
        roots = np.stack([q / a, c / q])
    return np.where(np.isfinite(roots) & (roots > 0.0), roots, np.inf).min(axis=0)
