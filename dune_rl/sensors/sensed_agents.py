"""The agents that an agent can look at: those of other groups, and of its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.state import GroupState, State


@dataclass(frozen=True)
class SensedAgents:
    """The A agents of the groups that are looked at, for each of N rows.

    `position_w` and `velocity_w` are (N, A, 2) [m, m/s]; `present` (N, A) is False for the looking agent
    itself, and for agents that are not in the scene. `radius_m` and `is_robot` are (A,).
    """

    position_w: Array
    velocity_w: Array
    present: Flags
    radius_m: Array
    is_robot: Flags


def sense_agents(names: Sequence[str], observer: GroupState, state: State) -> SensedAgents:
    """The agents of the groups `names` in the scene of each agent of the group `observer`."""
    rows = len(observer.motion.position_w)
    positions, velocities = [np.zeros((rows, 0, 2))], [np.zeros((rows, 0, 2))]
    present, radii, robots = [np.zeros((rows, 0), bool)], [np.zeros(0)], [np.zeros(0, bool)]
    for name in names:
        other = state.groups[name]
        if _is_alone(other, observer):
            continue
        positions.append(_for_each(other.motion.position_w, other, observer))
        velocities.append(_for_each(other.motion.velocity_w, other, observer))
        is_itself = (
            np.eye(observer.count, dtype=bool) if name == observer.name else np.zeros((1, other.count), bool)
        )
        there = np.tile(~is_itself, (rows // len(is_itself), 1))
        if other.absent is not None:
            there &= ~np.repeat(other.by_scene(other.absent), observer.count, axis=0)
        present.append(there)
        radii.append(np.full(other.count, other.body.radius_m))
        robots.append(np.full(other.count, other.body.is_robot))
    return SensedAgents(
        np.concatenate(positions, axis=1),
        np.concatenate(velocities, axis=1),
        np.concatenate(present, axis=1),
        np.concatenate(radii),
        np.concatenate(robots),
    )


def sense_goals(names: Sequence[str], observer: GroupState, state: State) -> Array:
    """The goals (N, A, 2) [m] of the agents that `sense_agents` finds, in the same order."""
    rows = len(observer.motion.position_w)
    goals = [np.zeros((rows, 0, 2))]
    for name in names:
        other = state.groups[name]
        if not _is_alone(other, observer):
            goals.append(_for_each(other.goal.position_w, other, observer))
    return np.concatenate(goals, axis=1)


def _is_alone(other: GroupState, observer: GroupState) -> bool:
    """Whether a group has nobody but the one agent of a scene that looks."""
    return other.name == observer.name and other.count == 1


def _for_each(values: Array, other: GroupState, observer: GroupState) -> Array:
    """The values (M G, 2 or more) of a group in plan view, for each agent of `observer`: (N, G, 2)."""
    return np.repeat(other.by_scene(values[:, :2]), observer.count, axis=0)
