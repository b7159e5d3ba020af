"""States of groups for sensors to read, made without a simulation."""

from typing import Any

import numpy as np
from poses import seen_at
from scenes import about

from dune_rl.geometry.frames import multiply_quaternions, roll_pitch_yaw, rotation_matrices, to_body
from dune_rl.sensors.sensor import Sensor
from dune_rl.state import (
    BodyDescription,
    ContactState,
    EpisodeState,
    GoalState,
    GroupState,
    JointState,
    Motion,
    State,
)

STEP_S = 0.05


class NoGround:
    """Ground queries that no sensor makes."""

    extents = np.zeros((0, 4))

    def height(self, xy: np.ndarray) -> np.ndarray:
        raise AssertionError("a sensor does not read the ground from the state")

    def clearance(self, xy: np.ndarray) -> np.ndarray:
        raise AssertionError("a sensor does not read clearance")


class FixedProximity:
    """Neighbours and clearances that are given."""

    def __init__(self, neighbours: np.ndarray, clearance: np.ndarray) -> None:
        self._neighbours, self._clearance = neighbours, clearance

    def clearance(self, group: str) -> np.ndarray:
        return self._clearance.copy()

    def neighbours(self, group: str) -> np.ndarray:
        return self._neighbours


def motion_of(states: np.ndarray, joints: JointState | None = None) -> Motion:
    """The motion of bodies in physics states (N, 13): position, quaternion xyzw, velocity, turn."""
    states = np.atleast_2d(np.asarray(states, float))
    rotation = rotation_matrices(states[:, 3:7])
    velocity, angular = states[:, 7:10], states[:, 10:13]
    return Motion(
        states[:, :3],
        roll_pitch_yaw(rotation),
        velocity,
        angular,
        np.zeros(len(states), bool),
        joints,
        rotation=rotation,
        velocity_b=to_body(rotation, velocity),
        angular_b=to_body(rotation, angular),
    )


def joints_from(drive: np.ndarray) -> JointState:
    """The joints' state from rows (N, 3 * J) as physics orders them: angles, speeds, torques."""
    return JointState(*np.split(np.atleast_2d(drive), 3, axis=1))


def resting(count: int, joints: JointState | None = None) -> Motion:
    """Bodies that stand still at the world's origin."""
    states = np.zeros((count, 13))
    states[:, 6] = 1.0
    return motion_of(states, joints)


def group_state(
    motion: Motion,
    neighbours: np.ndarray | None = None,
    *,
    streams=None,
    steps=0,
    seed: int = 0,
    count: int = 1,
    name: str = "rover",
    goal: GoalState | None = None,
    step_s: float = STEP_S,
) -> GroupState:
    """A group of bodies in `motion`; `streams` number their episodes, from 0 on without one."""
    rows = len(motion.position_w)
    none = np.zeros(rows, np.int64)
    ids = np.broadcast_to(np.arange(rows) if streams is None else np.asarray(streams, np.int64), rows).copy()
    zero = np.zeros(rows)
    return GroupState(
        name,
        count,
        BodyDescription(is_robot=True),
        EpisodeState(seed, ids, np.broadcast_to(np.asarray(steps, np.int64), rows).copy(), ids, step_s),
        motion,
        ContactState(none > 0, none, none),
        GoalState(np.zeros((rows, 2)), zero, zero, zero) if goal is None else goal,
        none > 0,
        FixedProximity(
            seen_at(np.zeros((rows, 0, 4)) if neighbours is None else neighbours),
            np.full(rows, np.inf),
        ),
    )


def write(array: np.ndarray, index: Any, values: Any) -> None:
    """Set entries of an array of a state, which nothing but a test may write."""
    array.setflags(write=True)
    array[index] = values
    array.setflags(write=False)


def state_of(*groups: GroupState) -> State:
    """The state of scenes with these groups."""
    first = groups[0]
    scenes = len(first.motion.position_w) // first.count
    return State({group.name: group for group in groups}, NoGround(), scenes)


def standing_at(positions: np.ndarray, yaws: np.ndarray, pitch: float = 0.0) -> Motion:
    """Bodies at rest at `positions` (N, 3), heading `yaws` (N,), noses down by `pitch`."""
    states = np.zeros((len(positions), 13))
    states[:, :3] = positions
    for row, yaw in enumerate(yaws):
        states[row, 3:7] = multiply_quaternions(about([0, 0, 1], yaw), about([0, 1, 0], pitch))
    return motion_of(states)


def state_at(
    positions: np.ndarray, yaws: np.ndarray, neighbours: np.ndarray | None = None, pitch: float = 0.0
) -> GroupState:
    """A group at rest at `positions` (N, 3), heading `yaws` (N,); `neighbours` are (N, K, 4 or more)."""
    return group_state(standing_at(positions, yaws, pitch), neighbours)


def episode_state(streams, steps, seed: int = 5) -> GroupState:
    """Bodies at rest at the origin, at `steps` of the episodes `streams`."""
    return group_state(resting(len(np.atleast_1d(streams))), streams=streams, steps=steps, seed=seed)


def begin(sensor: Sensor, mask: np.ndarray, now: GroupState) -> None:
    """Begin episodes of a sensor that is alone in its scenes."""
    sensor.begin(mask, now, state_of(now))


def measure(sensor: Sensor, now: GroupState) -> None:
    """Measure with a sensor that is alone in its scenes."""
    sensor.measure(now, state_of(now))
