"""Termination terms: when an agent's episode ends.

A term is a function of the state and the agent group that returns flags (N,), or a class of such functions
where something must be remembered; its keyword parameters are its settings.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Flags
from dune_rl.state.state import GroupState, State


def goal_reached(
    state: State, group: GroupState, *, distance_m: Annotated[float, Field(gt=0.0)] = 0.75
) -> Flags:
    """Whether the goal is nearer than `distance_m`."""
    return group.goal.distance < distance_m


class Stuck:
    """Whether an agent has stayed within `distance_m` of one place for `steps` control steps."""

    def __init__(
        self,
        num_rows: int,
        *,
        distance_m: Annotated[float, Field(ge=0.0)] = 0.1,
        steps: Annotated[int, Field(ge=1)] = 300,
    ) -> None:
        self._distance_m, self._limit = distance_m, steps
        self._anchor_w = np.zeros((num_rows, 2))
        self._steps = np.zeros(num_rows, np.int64)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin at the present places of the agents in `mask` (N,)."""
        self._anchor_w[mask] = group.motion.position_w[mask, :2]
        self._steps[mask] = 0

    def __call__(self, state: State, group: GroupState) -> Flags:
        """Flags (N,); to be called once a control step."""
        position = group.motion.position_w[:, :2]
        offset = position - self._anchor_w
        moved = np.hypot(offset[:, 0], offset[:, 1]) > self._distance_m
        self._steps += 1
        np.copyto(self._anchor_w, position, where=moved[:, None])
        self._steps[moved] = 0
        return self._steps >= self._limit


class LongCollision:
    """Whether more than `steps` scans of the episode had a return nearer than `distance_m`.

    Scans are those of the paper's published code (640 beams over the full circle, 0.15 to 10 m), one for each
    control step.
    """

    needs_scan = True

    def __init__(
        self,
        num_rows: int,
        *,
        distance_m: Annotated[float, Field(gt=0.0)] = 0.3,
        steps: Annotated[int, Field(ge=1)] = 600,
    ) -> None:
        self._distance_m, self._limit = distance_m, steps
        self._steps = np.zeros(num_rows, np.int64)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """No scan has been made in the episodes of the agents in `mask` (N,)."""
        self._steps[mask] = 0

    def __call__(self, state: State, group: GroupState) -> Flags:
        """Flags (N,); to be called once a control step."""
        # Nothing is near where there is no return.
        self._steps += group.nearest_return < self._distance_m
        return self._steps > self._limit


def flipped(
    state: State, group: GroupState, *, angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 85.0
) -> Flags:
    """Whether roll, pitch or tilt is more than `angle_deg`."""
    limit = math.radians(angle_deg)
    angles = np.abs(group.motion.roll_pitch_yaw)
    # Upside down has small roll and pitch in some conventions; the tilt is half a turn in all.
    turned: Flags = np.maximum(np.maximum(angles[:, 0], angles[:, 1]), group.motion.tilt) > limit
    return turned


def contact(state: State, group: GroupState) -> Flags:
    """Whether a collision began in this step."""
    return group.contacts.new > 0


def out_of_world(
    state: State, group: GroupState, *, margin_m: Annotated[float, Field(ge=0.0)] = 0.3
) -> Flags:
    """Whether an agent's origin is outside the terrain, or within `margin_m` of its edge."""
    extents = state.extents(group)
    position = group.motion.position_w[:, :2]
    outside = (position < extents[:, 0::2] + margin_m) | (position > extents[:, 1::2] - margin_m)
    return outside[:, 0] | outside[:, 1]


def time_limit(state: State, group: GroupState, *, max_steps: Annotated[int, Field(ge=1)] = 2000) -> Flags:
    """Whether the episode has had `max_steps` control steps; it truncates (`truncates: true`)."""
    return group.episode.steps >= max_steps
