"""Reward terms of actors that learn, which read the robots of their scene and what these are about to do.

A robot's way is the straight-line path from it to its goal. Robots whose own episode is over have none: only
contacts with them count, the other terms take them for absent. `groups` names the groups of robots that
count; if it is empty, all robots do.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import one_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

Metres = Annotated[float, Field(gt=0.0)]


class Robots(NamedTuple):
    """The R robots of each of M scenes, in plan view.

    `position_w`, `velocity_w` and `goal_w` (M, R, 2) [m, m/s], `progress` (M, R): metres nearer to the goal
    than one control step before, and `active` (M, R): whether the robot's own episode goes on.
    """

    position_w: Array
    velocity_w: Array
    goal_w: Array
    progress: Array
    active: Flags


def robots_of(state: State, group: GroupState, names: tuple[str, ...] = ()) -> Robots:
    """The robots of the groups in `names`; if it is empty, of all groups of robots but `group`.

    Without any there is one that is not active. Raises ConfigError for a group that is not there.
    """
    unknown = [name for name in names if name not in state.groups]
    if unknown:
        raise ConfigError(f"there is no group {unknown[0]!r} of agents; choose {one_of(list(state.groups))}")
    found = [
        other
        for name, other in state.groups.items()
        if name != group.name and (name in names if names else other.body.is_robot)
    ]
    if not found:
        # One that is not active.
        none = np.zeros((len(group.done) // group.count, 1, 2))
        return Robots(none, none, none, none[..., 0], none[..., 0].astype(bool))

    def join(read: Callable[[GroupState], Array]) -> Array:
        return np.concatenate([one.by_scene(read(one)) for one in found], axis=1)

    return Robots(
        join(lambda one: one.motion.position_w[:, :2]),
        join(lambda one: one.motion.velocity_w[:, :2]),
        join(lambda one: one.goal.position_w),
        join(lambda one: one.goal.previous_distance - one.goal.distance),
        np.concatenate([~one.done.reshape(-1, one.count) for one in found], axis=1),
    )


def closing_in(
    state: State,
    group: GroupState,
    *,
    groups: tuple[str, ...] = (),
    ahead_m: Annotated[float, Field(ge=0.0)] = 2.0,
) -> Array:
    """Metres that the agent itself moved in this step towards the place `ahead_m` ahead of the nearest robot.

    The place is on the robot's way, at most as far as its goal. What the robot moves earns nothing.
    """
    robots = robots_of(state, group, groups)
    along, length = unit_vectors(robots.goal_w - robots.position_w)
    places = robots.position_w + np.minimum(length, ahead_m)[..., None] * along
    own = group.by_scene(group.motion.position_w[:, :2])
    nearest, present = _nearest(own, robots)
    place = np.take_along_axis(places, nearest[..., None], axis=1)
    towards, _ = unit_vectors(place - own)
    velocity = group.by_scene(group.motion.velocity_w[:, :2])
    moved = (velocity * towards).sum(axis=-1) * group.episode.step_s
    return np.where(present, moved, 0.0).reshape(-1)


def blocking(
    state: State,
    group: GroupState,
    *,
    groups: tuple[str, ...] = (),
    ahead_m: Metres = 4.0,
    width_m: Metres = 1.0,
) -> Array:
    """How much the agent is in a robot's way: 1 right before its origin, 0 behind it and beyond its goal.

    It falls linearly to 0 at `ahead_m` ahead of the robot, and at `width_m` beside its way.
    """
    robots = robots_of(state, group, groups)
    along, length = unit_vectors(robots.goal_w - robots.position_w)
    offset = group.by_scene(group.motion.position_w[:, :2])[:, :, None] - robots.position_w[:, None]
    ahead = (offset * along[:, None]).sum(axis=-1)
    beside = np.abs(offset[..., 0] * along[:, None, :, 1] - offset[..., 1] * along[:, None, :, 0])
    inside = (ahead > 0.0) & (ahead <= length[:, None]) & robots.active[:, None]
    share = np.maximum(1.0 - ahead / ahead_m, 0.0) * np.maximum(1.0 - beside / width_m, 0.0)
    most: Array = np.where(inside, share, 0.0).max(axis=-1)
    return most.reshape(-1)


def robot_progress(state: State, group: GroupState, *, groups: tuple[str, ...] = ()) -> Array:
    """Metres by which the nearest robot came nearer to its goal in this step; weigh it negatively."""
    robots = robots_of(state, group, groups)
    nearest, present = _nearest(group.by_scene(group.motion.position_w[:, :2]), robots)
    progress = np.take_along_axis(robots.progress, nearest, axis=1)
    return np.where(present, progress, 0.0).reshape(-1)


class _JudgedContact(ABC):
    """A value for contacts with robots that depends on the closing speeds of both: how fast each approaches.

    A closing speed is the component of a velocity towards the other one [m/s], and the larger one of this
    step and the last, as a contact slows what moves; below `min_speed_mps` [m/s] nobody approaches. With
    `groups` only robots of these groups count. The robot of a contact is the nearest one. A contact begins
    where the two have not touched for a second, as collisions are counted. Of actors that are robots
    themselves, which touch obstacles too, only the step in which a contact with a robot begins has a value.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        groups: tuple[str, ...] = (),
        min_speed_mps: Annotated[float, Field(ge=0.0)] = 0.05,
    ) -> None:
        self._groups, self._min_speed_mps = groups, min_speed_mps
        self._own, self._theirs = np.zeros((2, num_rows, 1))

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has moved in the episodes of the agents in `mask` (N,)."""
        self._own[mask] = 0.0
        self._theirs[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Values (N,); to be called once a control step."""
        robots = robots_of(state, group)
        rows, count = len(group.done), robots.active.shape[1]
        position = group.by_scene(group.motion.position_w[:, :2])
        towards, _ = unit_vectors(robots.position_w[:, None] - position[:, :, None])
        velocity = group.by_scene(group.motion.velocity_w[:, :2])[:, :, None]
        own = (velocity * towards).sum(axis=-1).reshape(rows, count)
        theirs = -(robots.velocity_w[:, None] * towards).sum(axis=-1).reshape(rows, count)
        most_own, most_theirs = np.maximum(own, self._own), np.maximum(theirs, self._theirs)
        self._own, self._theirs = own, theirs
        contacts = group.contacts
        touching, begins = contacts.touching, contacts.new > 0
        if group.body.is_robot:
            touching = begins = contacts.new_by_kind.get("robot", np.zeros(rows, int)) > 0
        if not touching.any():
            return np.zeros(rows)
        nearest, _ = _nearest(position, robots._replace(active=np.ones_like(robots.active)))
        chosen = np.arange(rows), nearest.reshape(-1)
        # An agent may touch any robot, of which those of the chosen groups count.
        counts = [
            not self._groups or name in self._groups
            for name, other in state.groups.items()
            if name != group.name and other.body.is_robot
            for _ in range(other.count)
        ]
        touches = touching & np.array(counts or [False], bool)[nearest.reshape(-1)]
        value = self._judge(most_own[chosen], most_theirs[chosen], begins)
        return np.where(touches, value, 0.0)

    @abstractmethod
    def _judge(self, own: Array, theirs: Array, begins: Flags) -> Array:
        """Values (N,) at closing speeds `own` and `theirs` (N,) [m/s]; `begins` marks new contacts."""
        ...


class RanIntoRobot(_JudgedContact):
    """1 in a step in which a contact with a robot begins that the agent itself brought about.

    It is `pushing` in each further step of a contact in which the agent goes on to move into the robot. The
    agent does if its closing speed exceeds `min_speed_mps` and the robot's closing speed.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        groups: tuple[str, ...] = (),
        min_speed_mps: Annotated[float, Field(ge=0.0)] = 0.05,
        pushing: Annotated[float, Field(ge=0.0)] = 0.1,
    ) -> None:
        super().__init__(num_rows, groups=groups, min_speed_mps=min_speed_mps)
        self._pushing = pushing

    def _judge(self, own: Array, theirs: Array, begins: Flags) -> Array:
        moves_into_it = (own > theirs) & (own > self._min_speed_mps)
        return np.where(moves_into_it, np.where(begins, 1.0, self._pushing), 0.0)


class HitByRobot(_JudgedContact):
    """1 in a step in which a contact with a robot begins in which the robot alone moved into the agent.

    The robot did if its closing speed exceeds `min_speed_mps` and the agent's does not: the agent stood in
    its way, crossed it or walked ahead of it. What the agent did before the last two control steps does not
    matter.
    """

    def _judge(self, own: Array, theirs: Array, begins: Flags) -> Array:
        return np.where(begins & (theirs > self._min_speed_mps) & (own <= self._min_speed_mps), 1.0, 0.0)


def _nearest(own: Array, robots: Robots) -> tuple[np.ndarray, Flags]:
    """The number of the nearest active robot to each agent at `own` (M, G, 2), and whether there is one.

    Both are (M, G).
    """
    offset = robots.position_w[:, None] - own[:, :, None]
    distance = np.where(robots.active[:, None], np.hypot(offset[..., 0], offset[..., 1]), np.inf)
    nearest = distance.argmin(axis=-1)
    return nearest, np.isfinite(distance.min(axis=-1))
