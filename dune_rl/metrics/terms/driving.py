"""Metric terms of how an agent drives: its path, attitude, slip, jerk and energy."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.metrics.terms.paper import vector_norms
from dune_rl.state.state import GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.shortest_way import shortest_way_m


class PathLength:
    """Horizontal length [m] of the path since the last control step; its sum is that of the episode."""

    def __init__(self, num_rows: int) -> None:
        self._last_w = np.zeros((num_rows, 2))

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Paths begin at the present places of the agents in `mask` (N,)."""
        self._last_w[mask] = group.motion.position_w[mask, :2]

    def __call__(self, state: State, group: GroupState) -> Array:
        """Lengths (N,); to be called once a control step."""
        position = group.motion.position_w[:, :2]
        moved: Array = np.hypot(*(position - self._last_w).T)
        self._last_w[:] = position
        return moved


class Spl:
    """Success weighted by path length (SPL), so far: 0 until `success` is 1.

    Then it is the straight distance to the first goal, over the length of the path or that distance,
    whichever is more (Anderson et al. 2018, On Evaluation of Embodied Navigation Agents, where the distance
    is along the shortest path: a straight line is a lower bound of it, and so of SPL). Both count to where
    the goal is reached, which is short of it: a straight drive has 1, and any detour less.
    """

    def __init__(self, num_rows: int, *, termination: str = "goal_reached") -> None:
        self._termination = termination
        self._path = PathLength(num_rows)
        self._straight_m = np.zeros(num_rows)
        self._length_m = np.zeros(num_rows)
        self._share = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """The episodes of the agents in `mask` (N,) begin."""
        self._path.reset(mask, group)
        self._straight_m[mask] = group.goal.distance[mask]
        self._length_m[mask] = 0.0
        self._share[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Shares (N,); to be called once a control step."""
        self._length_m += self._path(state, group)
        reached = group.ended_by(self._termination) & (self._share == 0.0)
        if reached.any():
            straight = np.maximum(self._straight_m - group.goal.distance, 0.0)
            longest = np.maximum(self._length_m, straight)
            share = np.divide(straight, longest, out=np.ones_like(longest), where=longest > 0.0)
            self._share = np.where(reached, share, self._share)
        clean = group.contacts.total == 0
        return np.where(clean, self._share, 0.0)


class BarnScore:
    """The score of the BARN challenge, so far: 0 until `success` is 1.

    Then it is T / clip(t, 2 T, 8 T), with t the time to the first goal and T the time for the shortest way at
    `top_speed_mps`: 0.5 at best. Ways are those of a disc of half the body's width. Xiao et al. 2022,
    Autonomous Ground Navigation in Highly Constrained Spaces.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        top_speed_mps: Annotated[float, Field(gt=0.0, description="of the shortest way [m/s]")] = 2.0,
        termination: str = "goal_reached",
    ) -> None:
        self._top_speed_mps, self._termination = top_speed_mps, termination
        self._start_w, self._goal_w = np.zeros((2, num_rows, 2))
        self._score = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """The episodes of the agents in `mask` (N,) begin."""
        self._start_w[mask] = group.motion.position_w[mask, :2]
        self._goal_w[mask] = group.goal.position_w[mask]
        self._score[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Scores (N,)."""
        reached = group.ended_by(self._termination) & (self._score == 0.0)
        for row in np.flatnonzero(reached).tolist():
            assert isinstance(state.ground, BatchedWorlds)
            world = state.ground.worlds[row // group.count]
            way_m = shortest_way_m(world, self._start_w[row], self._goal_w[row], group.body.radius_m)
            least_s = way_m / self._top_speed_mps
            taken_s = group.episode.steps[row] * group.episode.step_s
            if np.isfinite(least_s):
                self._score[row] = least_s / np.clip(taken_s, 2.0 * least_s, 8.0 * least_s)
        return np.where(group.contacts.total == 0, self._score, 0.0)


def ground_speed(state: State, group: GroupState) -> Array:
    """Horizontal speed [m/s]."""
    velocity = group.motion.velocity_w
    horizontal: Array = np.hypot(velocity[:, 0], velocity[:, 1])
    return horizontal


def duration(state: State, group: GroupState) -> Array:
    """Time since the episode began [s]."""
    return np.multiply(group.episode.steps, group.episode.step_s, dtype=np.float64)


def abs_roll(state: State, group: GroupState) -> Array:
    """Size of the roll angle [deg]."""
    return np.rad2deg(np.abs(group.motion.roll_pitch_yaw[:, 0]))


def abs_pitch(state: State, group: GroupState) -> Array:
    """Size of the pitch angle [deg]."""
    return np.rad2deg(np.abs(group.motion.roll_pitch_yaw[:, 1]))


class Jerk:
    """Size of the change of the acceleration from one control step to the next, by its time [m/s³].

    It is that of the mean acceleration of a control step, in the body frame; NaN in the first step.
    """

    def __init__(self, num_rows: int) -> None:
        self._last_b = np.full((num_rows, 3), np.nan)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """There is no acceleration before the episodes of the agents in `mask` (N,)."""
        self._last_b[mask] = np.nan

    def __call__(self, state: State, group: GroupState) -> Array:
        """Sizes (N,); to be called once a control step."""
        acceleration = group.motion.acceleration_b
        change = acceleration - self._last_b
        self._last_b[:] = acceleration
        return vector_norms(change) / group.episode.step_s


def slip(state: State, group: GroupState, *, least_mps: Annotated[float, Field(gt=0.0)] = 0.1) -> Array:
    """Longitudinal slip ratio ``|r w - v| / max(|r w|, |v|)``, in 0 to 2.

    v [m/s] is the forward speed and r w that of the wheels' rims, the mean over the motors (Wong, Theory of
    Ground Vehicles, section 1.3, without the sign). NaN where both are below `least_mps`.
    """
    joints, radius = group.motion.joints, group.body.wheel_radius_m
    if joints is None or radius is None:
        raise ConfigError(f"slip is that of wheels, and {group.name} has none: leave this metric out for it")
    rim, forward = radius * joints.speed.mean(axis=1), group.motion.velocity_b[:, 0]
    fastest = np.maximum(np.abs(rim), np.abs(forward))
    ratio = np.full(len(rim), math.nan)
    np.divide(np.abs(rim - forward), fastest, out=ratio, where=fastest >= least_mps)
    return ratio


slip.needs_joints = True  # type: ignore[attr-defined]


def energy_wh(state: State, group: GroupState) -> Array:
    """Energy drawn from the battery in this step [W h]."""
    if group.energy is None:
        raise ConfigError(
            f"the energy of {group.name} is not measured: set metrics.energy=true, for a robot with a battery"
        )
    # The work of diverged physics may be anything.
    work_j = np.where(group.motion.diverged, 0.0, group.energy.work_j)
    return group.energy.battery.drawn_wh(work_j, group.episode.step_s)


class BatteryShare:
    """Share of the battery's capacity that the episode has used."""

    def __init__(self, num_rows: int) -> None:
        self._drawn_wh = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has been drawn in the episodes of the agents in `mask` (N,)."""
        self._drawn_wh[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Shares (N,); to be called once a control step."""
        self._drawn_wh += energy_wh(state, group)
        assert group.energy is not None
        return self._drawn_wh / group.energy.battery.capacity_wh


class BatteryRange:
    """Distance [km] that a full battery lasts for, at the use and over the way of the episode.

    The way is counted level; NaN before anything is drawn.
    """

    def __init__(self, num_rows: int) -> None:
        self._share = BatteryShare(num_rows)
        self._way_m = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has been drawn, and no way made, in the episodes of the agents in `mask` (N,)."""
        self._share.reset(mask, group)
        self._way_m[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Ranges (N,); to be called once a control step."""
        share = self._share(state, group)
        velocity = group.motion.velocity_w
        self._way_m += np.hypot(velocity[:, 0], velocity[:, 1]) * group.episode.step_s
        ranges = np.full(len(share), np.nan)
        np.divide(self._way_m / 1000.0, share, out=ranges, where=share > 0.0)
        return ranges
