"""The behaviour `crossing`: cuts the way of the nearest robot, at a set time to contact."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.ranges import Speed
from dune_rl.behaviours.steering import SteeredBehaviour, nearest_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.state import GroupState, State

# A slower robot is standing: nothing crosses its way [m/s].
_STANDS_MPS = 0.05
# Who is this near to the place to cross the line at, and changes its side, has crossed it [m].
_NEAR_M = 0.5


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
        range_m: Annotated[
            float, Field(gt=0.0, le=1_000.0, description="robots farther away are left [m]")
        ] = 10.0,
        beyond_m: Annotated[
            float, Field(ge=0.0, le=100.0, description="how far it goes on behind the line [m]")
        ] = 3.0,
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
        passes = (self._side * aside < 0.0) & (np.abs(lead) < _NEAR_M)
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
