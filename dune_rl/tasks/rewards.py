"""Reward terms: what a control step earns each agent, before weights.

A term is a function of the state and the agent group that returns (N,); its keyword parameters are its
settings. The formulae of point-goal navigation are those of Vice & Sukthankar 2025, section 2.6 and
Table 2; the published code differs in its numbers, which `conf/task/dune_code.yaml` has.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.state.state import GroupState, State


def distance(
    state: State,
    group: GroupState,
    *,
    scale: float = 0.3,
    min_progress_m: Annotated[float, Field(ge=0.0)] = 0.0,
    signed: bool = False,
    heading_limit_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 90.0,
    misaligned: float = -0.001,
) -> Array:
    """`scale` for each metre nearer to the goal, while the goal is within `heading_limit_deg` ahead.

    Progress of no more than `min_progress_m`, and any beyond the heading limit, earns `misaligned` instead.
    With `signed`, moving away within the limit earns its negative distance, as in the published code.
    """
    progress = group.goal.previous_distance - group.goal.distance
    moved = np.abs(progress) if signed else progress
    earns = (moved > min_progress_m) & (np.abs(group.goal.bearing) <= math.radians(heading_limit_deg))
    return np.where(earns, progress * scale, misaligned)


def heading(state: State, group: GroupState, *, bonus: float = 0.01) -> Array:
    """`bonus` for facing the goal, 0 for a goal across, falling to `-bonus` for facing away."""
    angle = np.abs(group.goal.bearing)
    toward = 1.0 - 2.0 * angle / np.pi
    away = -2.0 * (angle - np.pi / 2) / np.pi
    return bonus * np.where(angle <= np.pi / 2, toward, away)


def velocity(
    state: State, group: GroupState, *, speed_scale: float = 0.0025, turn_scale: float = 0.0
) -> Array:
    """`speed_scale` [s/m] times forward speed, less `turn_scale` [s/rad] times the yaw rate's magnitude."""
    reward = speed_scale * group.motion.velocity_b[:, 0]
    if turn_scale:
        reward -= turn_scale * np.abs(group.motion.angular_b[:, 2])
    return reward


def collision(state: State, group: GroupState, *, distance_m: Annotated[float, Field(ge=0.0)] = 0.2) -> Flags:
    """1 where something is touched or the clearance is less than `distance_m`."""
    return (group.clearance < distance_m) | group.contacts.touching


def scan_collision(
    state: State,
    group: GroupState,
    *,
    distance_m: Annotated[
        float, Field(gt=0.0, description="nearest return of a scan: less is too close [m]")
    ] = 0.3,
) -> Flags:
    """1 where a scan as the paper's published code makes it has a return nearer than `distance_m`.

    It has 640 beams over the full circle, 0.15 to 10 m; without a return nothing is near.
    """
    near: Flags = group.nearest_return < distance_m
    return near


scan_collision.needs_scan = True  # type: ignore[attr-defined]


def contact(state: State, group: GroupState) -> Counts:
    """Number of collisions that began in this step: one for each body, however long it is touched."""
    return group.contacts.new


def ended_by(state: State, group: GroupState, *, termination: str) -> Flags:
    """1 in the step in which the termination term called `termination` is true."""
    return group.ended_by(termination)


def progress(state: State, group: GroupState) -> Array:
    """Metres nearer to the goal or way point than one step before."""
    return group.goal.previous_distance - group.goal.distance


def smoothness(state: State, group: GroupState) -> Array:
    """Size of the acceleration [m/s²] plus that of the angular velocity [rad/s], whose mean is TSR.

    Smaller values are smoother: take a negative weight. Gravity is left out.
    """
    motion = group.motion
    found: Array = np.linalg.norm(motion.acceleration_b, axis=1) + np.linalg.norm(motion.angular_b, axis=1)
    return found


def near_miss(
    state: State,
    group: GroupState,
    *,
    comfort_m: Annotated[float, Field(gt=0.0)] = 1.2,
    own_group: bool = False,
) -> Array:
    """Closeness to the nearest agent of another group: 0 beyond `comfort_m`, growing to 1 on contact.

    With `own_group` the other agents of the own group count too. Distances are those of outlines, seen from
    above.
    """
    nearest = np.full(len(group.done), np.inf)
    proximity = state.groups[group.name].proximity
    for name in state.groups:
        if own_group or name != group.name:
            nearest = np.minimum(nearest, proximity.gap(group.name, name))
    return 1.0 - np.clip(nearest / comfort_m, 0.0, 1.0)
