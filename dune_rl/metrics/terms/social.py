"""Metric terms of an agent among others: distances, near misses, encounters and risk.

A gap is the distance between two outlines in plan view: rectangles, or discs of people. Times to contact are
those of the discs of half the width that cover a body. `groups` names the groups that count; without any, all
other agents do.
"""

import math
from collections.abc import Iterator
from itertools import product
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import one_of
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.state.state import GroupState, State

Metres = Annotated[float, Field(gt=0.0)]


def actor_gap(
    state: State, group: GroupState, *, groups: tuple[str, ...] = (), max_m: Metres = 12.0
) -> Array:
    """Gap [m] to the nearest other agent, at most `max_m`."""
    return np.clip(_gaps(state, group, groups), 0.0, max_m)


def seconds_near(
    state: State, group: GroupState, *, groups: tuple[str, ...] = (), within_m: Metres = 0.5
) -> Array:
    """Time [s] of this step if another agent is nearer than `within_m`, else 0.

    Its sum is the intrusion into personal space; with 0.5 m also the risk-seconds of the DUnE authors' later
    study of social navigation.
    """
    return np.where(_gaps(state, group, groups) < within_m, group.episode.step_s, 0.0)


def risk_seconds(
    state: State, group: GroupState, *, groups: tuple[str, ...] = (), within_m: Metres = 1.0
) -> Array:
    """Time [s] of this step, weighted by the nearness of the nearest other agent.

    The weight is 1 on contact, and 0 from `within_m` on. The risk-seconds of the DUnE authors'
    later study are others: `seconds_near` with 0.5 m.
    """
    nearness = 1.0 - np.clip(_gaps(state, group, groups) / within_m, 0.0, 1.0)
    risk: Array = nearness * group.episode.step_s
    return risk


# What collisions are named by, beside the kinds of users' own bodies.
_KINDS = ("static", "robot", "person", "vehicle", "animal", "drone")


def collisions_with(state: State, group: GroupState, *, kinds: tuple[str, ...] = ("static",)) -> Counts:
    """Number of collisions that began in this step with bodies of these classes.

    `static` is what never moves; agents are of the class of their body: robot, person, vehicle, animal,
    drone, or the `kind` of one's own.
    """
    known = (*_KINDS, *(other.body.kind for other in state.groups.values()))
    for kind in kinds:
        if kind not in known:
            raise ConfigError(f"collisions_with.kinds: there is no class {kind!r}; choose {one_of(known)}")
    new = group.contacts.new_by_kind
    return sum((new[kind] for kind in kinds if kind in new), np.zeros(len(group.done), np.int64))


class NearMisses:
    """1 in a step in which a near miss begins, -1 in one in which it turns out to be a collision.

    It is a spell in which the agent would touch another within `time_s` if both kept their velocities, and in
    which it touches nothing; the sum over an episode is their number. Time to contact as in Hayward 1972.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        groups: tuple[str, ...] = (),
        time_s: Annotated[float, Field(gt=0.0)] = 1.0,
    ) -> None:
        self._groups, self._time_s = groups, time_s
        self._was_near = np.zeros(num_rows, bool)
        self._counted = np.zeros(num_rows, bool)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """No spell goes on in the episodes of the agents in `mask` (N,)."""
        self._was_near[mask] = False
        self._counted[mask] = False

    def __call__(self, state: State, group: GroupState) -> Array:
        """Changes (N,) of the number; to be called once a control step."""
        touching = group.contacts.touching
        near = _times_to_contact(state, group, self._groups) < self._time_s
        begins = near & ~self._was_near & ~touching
        # On contact bodies bounce off, and may part in the very step: what was a spell until now counts too.
        spoilt = self._counted & self._was_near & touching
        self._counted = (self._counted | begins) & near & ~touching
        self._was_near = near
        return begins.astype(float) - spoilt


class Encounters:
    """Number of encounters with a minimum gap in [`least_m`, `most_m`).

    An encounter lasts while the gap to the nearest other agent stays below `within_m`. An encounter that
    has not ended counts by its minimum gap so far.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        groups: tuple[str, ...] = (),
        least_m: Annotated[float, Field(ge=0.0)] = 0.0,
        most_m: Metres = 1.2,
        within_m: Metres = 1.2,
    ) -> None:
        if not least_m < most_m <= within_m:
            raise ConfigError(
                f"encounters need least_m < most_m <= within_m (got {least_m:g}, {most_m:g}, {within_m:g})"
            )
        self._groups, self._range, self._within_m = groups, (least_m, most_m), within_m
        self._ended = np.zeros(num_rows)
        self._nearest_m = np.full(num_rows, np.inf)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """There was none in the episodes of the agents in `mask` (N,)."""
        self._ended[mask] = 0.0
        self._nearest_m[mask] = np.inf

    def __call__(self, state: State, group: GroupState) -> Array:
        """Numbers (N,); to be called once a control step."""
        gaps = np.maximum(_gaps(state, group, self._groups), 0.0)
        near = gaps < self._within_m
        self._ended += ~near & self._is_of_this_class
        self._nearest_m = np.where(near, np.minimum(self._nearest_m, gaps), np.inf)
        return self._ended + self._is_of_this_class

    @property
    def _is_of_this_class(self) -> Flags:
        least, most = self._range
        within: Flags = (self._nearest_m >= least) & (self._nearest_m < most)
        return within


def _gaps(state: State, group: GroupState, names: tuple[str, ...]) -> Array:
    """Gaps [m], (N,), to the nearest other agent of the groups; inf without any."""
    found = np.full(len(group.done), np.inf)
    proximity = state.groups[group.name].proximity
    for other in _others(state, group, names):
        found = np.minimum(found, proximity.gap(group.name, other.name))
    return found


def _times_to_contact(state: State, group: GroupState, names: tuple[str, ...]) -> Array:
    """Shortest times to contact [s], (N,), with other agents of the groups; inf without any."""
    found = np.full(len(group.done), np.inf)
    for other in _others(state, group, names):
        reach = group.body.radius_m + other.body.radius_m
        for mine, theirs in product(_discs(group), _discs(other)):
            _find_times_to_contact(
                mine, group.motion.velocity_w[:, :2], reach, theirs, other.motion.velocity_w[:, :2],
                group.count, other.count, other is group, found,
            )  # fmt: skip
    return found


def _discs(group: GroupState) -> list[Array]:
    """Centres (N, 2) [m] of the first disc of each body, of the second, and so on."""
    position, yaw = group.motion.position_w[:, :2], group.motion.yaw
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return [position + offset * ahead for offset in group.body.disc_offsets_m]


def _others(state: State, group: GroupState, names: tuple[str, ...]) -> Iterator[GroupState]:
    unknown = [name for name in names if name not in state.groups]
    if unknown:
        raise ConfigError(f"there is no group {unknown[0]!r} of agents; choose {one_of(list(state.groups))}")
    for name, other in state.groups.items():
        if not names or name in names:
            # The step's state is another object than the one in which goals were renewed.
            yield group if name == group.name else other


@compile_function
def _find_times_to_contact(
    position: Any, velocity: Any, reach: float, others: Any, velocities: Any, per_scene: int, number: int,
    same: bool, found: Any,
) -> None:  # fmt: skip
    """The shortest time [s] in which discs at constant velocities meet, where it is below `found` (N,).

    `position` (N, 2) [m] are those of `per_scene` agents in each scene, `others` (M * H, 2) those of `number`
    (H) agents; `reach` [m] is the sum of both radii, `velocity` and `velocities` [m/s] are those of the
    agents and of the others. `same` says that they are one group, whose agents are not compared with
    themselves. The time is 0 for discs that overlap.
    """
    for row in range(len(position)):
        scene, agent = row // per_scene, row % per_scene
        for other in range(number):
            if same and other == agent:
                continue
            index = scene * number + other
            x, y = others[index, 0] - position[row, 0], others[index, 1] - position[row, 1]
            u, v = velocities[index, 0] - velocity[row, 0], velocities[index, 1] - velocity[row, 1]
            apart = x * x + y * y - reach * reach
            if apart <= 0.0:
                found[row] = 0.0
                continue
            # |p + v t|^2 = reach^2, whose smaller root is the first contact.
            closing, square = -(x * u + y * v), u * u + v * v
            discriminant = closing * closing - square * apart
            if closing > 0.0 and discriminant >= 0.0:
                found[row] = min(found[row], apart / (closing + math.sqrt(discriminant)))
