"""Metric terms of the DUnE paper (Vice & Sukthankar 2025, section 2.5); accelerations have no gravity."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.state.state import GroupState, State


def ended_by(state: State, group: GroupState, *, termination: str) -> Flags:
    """1 in a step in which the termination term called `termination` is true."""
    return group.ended_by(termination)


class Success:
    """1 once the termination term `termination` has been true, for as long as there was no collision."""

    def __init__(self, num_rows: int, *, termination: str = "goal_reached") -> None:
        self._termination = termination
        self._reached = np.zeros(num_rows, bool)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has been reached in the episodes of the agents in `mask` (N,)."""
        self._reached[mask] = False

    def __call__(self, state: State, group: GroupState) -> Flags:
        """Flags (N,); to be called once a control step."""
        self._reached |= group.ended_by(self._termination)
        clean: Flags = group.contacts.total == 0
        return self._reached & clean


def collisions(state: State, group: GroupState) -> Counts:
    """Number of collisions that began in this step."""
    return group.contacts.new


def time_in_collision(state: State, group: GroupState) -> Array:
    """Time [s] of this step if anything but the ground is touched, else 0."""
    return np.where(group.contacts.touching, group.episode.step_s, 0.0)


def time_to_goal(state: State, group: GroupState, *, termination: str = "goal_reached") -> Array:
    """Time since the episode began [s] in a step that reaches the goal, else NaN."""
    return np.where(group.ended_by(termination), group.episode.steps * group.episode.step_s, np.nan)


def clearance(state: State, group: GroupState, *, max_m: Annotated[float, Field(gt=0.0)] = 12.0) -> Array:
    """Distance [m] from the outline to the nearest obstacle or other agent, at most `max_m`.

    Its mean over time is the paper's OC, with the range of the paper's LiDAR as `max_m`, which it reports
    where there is no obstacle.
    """
    return np.minimum(group.clearance, max_m)


def vertical_roughness(state: State, group: GroupState) -> Array:
    """Size of the vertical acceleration of the origin, in the body frame [m/s²]; its mean is VR."""
    return np.abs(group.motion.acceleration_b[:, 2])


def vort(
    state: State, group: GroupState, *, uneven_tilt_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 5.0
) -> Array:
    """Horizontal speed [m/s] where the tilt is more than `uneven_tilt_deg`, else NaN; its mean is VORT."""
    velocity = group.motion.velocity_w
    uneven = group.motion.tilt > math.radians(uneven_tilt_deg)
    return np.where(uneven, np.hypot(velocity[:, 0], velocity[:, 1]), np.nan)


def time_on_uneven(
    state: State, group: GroupState, *, uneven_tilt_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 5.0
) -> Array:
    """Time [s] of this step where the tilt is more than `uneven_tilt_deg`, as `vort` has it, else 0."""
    return np.where(group.motion.tilt > math.radians(uneven_tilt_deg), group.episode.step_s, 0.0)


def smoothness(state: State, group: GroupState) -> Array:
    """Size of the acceleration [m/s²] plus that of the angular velocity [rad/s]; its mean is TSR."""
    return vector_norms(group.motion.acceleration_b) + vector_norms(group.motion.angular_b)


def vector_norms(vectors: Array) -> Array:
    """Lengths (N,) of vectors (N, 3)."""
    lengths: Array = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths
