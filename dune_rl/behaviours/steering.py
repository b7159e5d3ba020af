"""What scripted actors have in common: from a wanted velocity, past everybody else, to the body's action."""

from abc import ABC, abstractmethod
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from dune_rl.behaviours.drivers.context import BoundBehaviour
from dune_rl.behaviours.orca_loops import avoid_collisions
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.state.state import GroupState, State


def _rising(limits: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= limits[0] <= limits[1]:
        raise ValueError(f"give the least, at least 0, and then the greatest (got {list(limits)})")
    return limits


Speed = Annotated[float, Field(gt=0.0, le=50.0, description="speed at which it goes [m/s]")]
Who = Annotated[str, Field(min_length=1, description="robots, or the name of a group")]
Range = Annotated[float, Field(ge=2.0, le=1_000.0, description="how far from its start, along x and y [m]")]
Places = Annotated[
    tuple[tuple[float, float], ...],
    Field(description="points [x, y] [m] in turn; none: random places within range_m"),
]
PauseRange = Annotated[
    tuple[float, float],
    AfterValidator(_rising),
    Field(description="shortest and longest pause at a place [s]"),
]

# Below this speed a body keeps its heading [m/s].
_STANDS_MPS = 0.03
# Bodies that need speed to turn keep this share of it.
_TURNING_SHARE = 0.4
# Bodies and obstacles that are farther away are not avoided [m].
_AVOIDED_WITHIN_M = 6.0
# Agents avoid collisions that are less far ahead in time: with other bodies, and with obstacles [s].
_HORIZONS_S = (2.5, 0.5)
# Gap that two agents keep between their outlines, for turning takes time; half of it is each one's [m].
_GAP_M = 0.1
# Wanted velocities are turned to the right by this, so that symmetry does not block agents [rad].
_TO_THE_RIGHT_RAD = 0.03
# Of two agents that avoid each other each makes this share of the change of velocity (reciprocity).
_SHARE_OF_BOTH = 0.5


class SteeredBehaviour(BoundBehaviour, ABC):
    """A behaviour that wants a velocity, and gets the nearest one at which it collides with nobody (ORCA).

    Actions are (N, 2): speed [m/s] and relative heading [rad]. `motion_models` are those of the bodies
    that it can move. A group that is not the agents' own avoids them, if it does, as they avoid it:
    each makes half of the change, or all of it where the other gives way to nobody.
    """

    motion_models: tuple[str, ...] = ("holonomic", "unicycle")
    # The part of avoiding robots that is the agents'.
    robots_share = _SHARE_OF_BOTH

    def __init__(self, num_rows: int, speed_mps: float) -> None:
        self._num_rows, self._speed_mps = num_rows, speed_mps
        self._fresh = np.ones(num_rows, bool)
        self._facing = np.full(num_rows, np.nan)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Forget the past of the agents in `mask` (N,)."""
        self._fresh = self._fresh | mask

    @abstractmethod
    def want(self, state: State, group: GroupState) -> Array:
        """The velocities (N, 2) [m/s] that the agents want in the world frame."""
        ...

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2)."""
        self._facing = np.full(self._num_rows, np.nan)
        velocity = self.avoid(state, group, self.want(state, group))
        self._fresh = np.zeros(self._num_rows, bool)
        return self.actions_of(velocity, group)

    def ignored(self, state: State) -> Flags:
        """Flags (K,) of the bodies that the agents do not avoid."""
        return np.zeros(len(state.surroundings.reach_m), bool)

    def avoid(self, state: State, group: GroupState, wanted: Array) -> Array:
        """The velocities (N, 2) nearest to those `wanted` that lead to no collision."""
        around = state.surroundings
        columns = around.columns(group.name)
        share = np.where(around.avoids, _SHARE_OF_BOTH, 1.0)
        share[around.is_robot] = self.robots_share
        share[self.ignored(state)] = 0.0
        distance, direction = around.obstacles(group.name)
        cos, sin = np.cos(_TO_THE_RIGHT_RAD), np.sin(_TO_THE_RIGHT_RAD)
        turned = wanted @ np.array([[cos, -sin], [sin, cos]])
        found = np.empty((state.num_scenes, group.count, 2))
        limit = np.full((state.num_scenes, group.count), self._limit_mps)
        avoid_collisions(
            around.position_w, around.velocity_w, around.reach_m + _GAP_M / 2, share, columns.start,
            np.ascontiguousarray(distance), np.ascontiguousarray(direction),
            turned.reshape(found.shape), limit, _AVOIDED_WITHIN_M, _HORIZONS_S, group.episode.step_s, found,
        )  # fmt: skip
        return found.reshape(-1, 2)

    @property
    def _limit_mps(self) -> float:
        """The highest speed of the body."""
        return self.context.vehicle.max_speed_mps

    def face(self, mask: Flags, points_w: Array, group: GroupState) -> None:
        """Have the agents in `mask` (N,) turn to `points_w` (N, 2) while they stand still."""
        offset = points_w - group.motion.position_w[:, :2]
        self._facing = np.where(mask, np.arctan2(offset[:, 1], offset[:, 0]), self._facing)

    def actions_of(self, velocity_w: Array, group: GroupState) -> Array:
        """Actions (N, 2) that move the bodies at `velocity_w` (N, 2) [m/s], as far as they turn in a step."""
        vehicle, yaw = self.context.vehicle, group.motion.yaw
        speed = np.hypot(velocity_w[:, 0], velocity_w[:, 1])
        stands = speed < _STANDS_MPS
        facing = np.where(np.isnan(self._facing), yaw, self._facing)
        course = np.where(stands, facing, np.arctan2(velocity_w[:, 1], velocity_w[:, 0]))
        heading = wrap_angle(course - yaw)
        left = np.maximum(np.abs(heading) - vehicle.max_yaw_rate_radps * group.episode.step_s, 0.0)
        least = _TURNING_SHARE if vehicle.turning_radius_m > 0.0 else 0.0
        share = np.where(left < np.pi / 2, np.cos(left), 0.0)
        return np.stack([np.where(stands, 0.0, speed * np.maximum(share, least)), heading], axis=1)


def draws_of(name: str, group: GroupState, row: int) -> np.random.Generator:
    """The random draws of an agent at its present step: equal whatever is beside its scene.

    Two calls with the same `name` in one step return generators of the same numbers.
    """
    episode = group.episode
    return stream(episode.seed, name, int(episode.streams[row]), int(episode.steps[row]))


def nearest_of(state: State, group: GroupState, who: str) -> tuple[Array, Array, Array, Array]:
    """The nearest of the bodies called `who` to each agent of a group, but for itself.

    Returns positions, velocities (N, 2) [m, m/s], yaws and distances (N,) [rad, m]; distances are inf where
    there is none.
    """
    around = state.surroundings
    chosen = np.flatnonzero(around.are_of(who))
    rows = np.arange(len(group.done))
    scenes, own = rows // group.count, around.columns(group.name).start + rows % group.count
    position = group.motion.position_w[:, :2]
    if not len(chosen):
        zeros = np.zeros_like(position)
        return position.copy(), zeros, zeros[:, 0], np.full(len(rows), np.inf)
    apart = np.linalg.norm(around.position_w[scenes][:, chosen] - position[:, None], axis=-1)
    apart[(chosen[None] == own[:, None]) | ~around.are_here[scenes][:, chosen]] = np.inf
    nearest = apart.argmin(axis=1)
    column = chosen[nearest]
    return (
        around.position_w[scenes, column],
        around.velocity_w[scenes, column],
        around.yaw[scenes, column],
        apart[rows, nearest],
    )
