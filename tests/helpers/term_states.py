"""States of agents for rewards, terminations and metrics to read, made without a simulation."""

from dataclasses import replace
from typing import Any

import numpy as np
from states import STEP_S, FixedProximity, NoGround

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.state import (
    BatteryModel,
    BodyDescription,
    ContactState,
    EnergyState,
    EpisodeState,
    GoalState,
    GroupState,
    JointState,
    Motion,
    ScanQueries,
    State,
)

EXTENT = (-50.0, 50.0, -20.0, 20.0)


class Extents(NoGround):
    """Ground of which terms read the extent alone."""

    def __init__(self, num_scenes: int, extent: tuple[float, float, float, float]) -> None:
        self.extents = np.tile(np.array(extent), (num_scenes, 1))


class FixedScan:
    """A scan whose nearest return [m] is given: of all agents, or of each."""

    def __init__(self, nearest: Any) -> None:
        self._nearest = np.asarray(nearest, float)

    def nearest_return(self, motion: Motion, neighbours: np.ndarray) -> np.ndarray:
        """What was given."""
        return np.broadcast_to(self._nearest, len(motion.position_w)).copy()


NO_RETURN = FixedScan(np.nan)


def agents(
    rows: int = 1,
    *,
    name: str = "rover",
    count: int = 1,
    position: Any = (0.0, 0.0, 0.0),
    roll_pitch_yaw: Any = (0.0, 0.0, 0.0),
    quaternion: Any = (0.0, 0.0, 0.0, 1.0),
    velocity_b: Any = (0.0, 0.0, 0.0),
    angular_b: Any = (0.0, 0.0, 0.0),
    velocity_w: Any = (0.0, 0.0, 0.0),
    acceleration_b: Any = (0.0, 0.0, 0.0),
    diverged: Any = False,
    distance: Any = 5.0,
    progress: Any = 0.0,
    bearing: Any = 0.0,
    clearance: Any = np.inf,
    touching: Any = False,
    new: Any = 0,
    total: Any = 0,
    step: int = 1,
    episode: int = 0,
    done: Any = False,
    work_j: Any = None,
    battery: BatteryModel | None = None,
    radius_m: float = 0.0,
    half_length_m: float = 0.0,
    endings: dict[str, Any] | None = None,
    wheel_radius_m: float | None = None,
    joint_speed: Any = None,
    scanner: ScanQueries | None = NO_RETURN,
    goal: Any = (0.0, 0.0),
    kind: str = "robot",
) -> GroupState:
    """`rows` agents in the open, 5 m from their goals and facing them, at rest, but for what is given.

    Values are of all agents, or one for each.
    """

    def vector(values: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(values, float), (rows, np.shape(values)[-1])).copy()

    def numbers(values: Any, kind: type = float) -> np.ndarray:
        return np.broadcast_to(np.asarray(values, kind), rows).copy()

    distances = numbers(distance)
    return GroupState(
        name,
        count,
        BodyDescription(kind, kind == "robot", radius_m, half_length_m, wheel_radius_m=wheel_radius_m),
        EpisodeState(0, numbers(episode, int), numbers(step, int), numbers(episode, int), STEP_S),
        Motion(
            vector(position),
            vector(roll_pitch_yaw),
            vector(velocity_w),
            np.zeros((rows, 3)),
            numbers(diverged, bool),
            None if joint_speed is None else _joints_at(np.broadcast_to(joint_speed, (rows, 4))),
            rotation=rotation_matrices(vector(quaternion)),
            velocity_b=vector(velocity_b),
            angular_b=vector(angular_b),
            acceleration_b=vector(acceleration_b),
        ),
        ContactState(numbers(touching, bool), numbers(new, int), numbers(total, int)),
        GoalState(vector(goal), distances, distances + numbers(progress), numbers(bearing)),
        numbers(done, bool),
        FixedProximity(np.zeros((rows, 0, 7)), numbers(clearance)),
        energy=None if work_j is None or battery is None else EnergyState(numbers(work_j), battery),
        scanner=scanner,
        endings={key: numbers(flags, bool) for key, flags in (endings or {}).items()},
    )


def _joints_at(speed: np.ndarray) -> JointState:
    """Joints (N, J) that turn at these speeds, without torque."""
    return JointState(np.zeros_like(speed), speed, np.zeros_like(speed))


class Discs:
    """Gaps of agents that are discs of their `radius_m`; all else is as a group has it."""

    def __init__(self, group: GroupState, groups: dict[str, GroupState]) -> None:
        self._groups = groups
        self.clearance, self.neighbours = group.proximity.clearance, group.proximity.neighbours

    def gap(self, group: str, other: str) -> np.ndarray:
        """Gaps (N,) to the nearest disc of another group, or to another of the own."""
        mine, theirs = self._groups[group], self._groups[other]
        offset = theirs.by_scene(theirs.motion.position_w[:, :2])[:, None]
        offset = offset - mine.by_scene(mine.motion.position_w[:, :2])[:, :, None]
        apart = np.hypot(offset[..., 0], offset[..., 1]) - mine.body.radius_m - theirs.body.radius_m
        if group == other:
            apart = np.where(np.eye(mine.count, dtype=bool), np.inf, apart)
        return apart.min(axis=2).reshape(-1)


def state_of(*groups: GroupState, extent: tuple[float, float, float, float] = EXTENT) -> State:
    """The state of scenes with these groups, whose gaps are those of discs."""
    scenes = len(groups[0].done) // groups[0].count
    known = {group.name: group for group in groups}
    seen = {name: replace(group, proximity=Discs(group, known)) for name, group in known.items()}
    return State(seen, Extents(scenes, extent), scenes)
