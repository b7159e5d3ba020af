"""The state of one control step: what sensors, behaviours, rewards, terminations and metrics read.

The simulation makes a `State` once a step, and its arrays cannot be written. Arrays of a group have the
leading axis N = M * G, of M scenes with G agents each, scene after scene: row m * G + g is agent g of scene
m. Units are SI; frames are suffixes: `_w` world, `_b` body (x forward, y left, z up).
"""

from collections.abc import Mapping
from dataclasses import FrozenInstanceError, dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Counts, Flags, freeze
from dune_rl.geometry.frames import rotation_from_angles, rotation_from_yaw, to_body
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.surroundings import GroupBodies, Surroundings


class GroundQueries(Protocol):
    """Queries of the ground and static obstacles of M scenes; points have the leading axis M."""

    @property
    def extents(self) -> Array:
        """Rectangles (xmin, xmax, ymin, ymax) [m] of the terrains, (M, 4)."""
        ...

    def height(self, xy: Array, scenes: Counts | None = None) -> Array:
        """Height of the ground [m], (M, ...), at points (M, ..., 2), or, of m `scenes` (m,), (m, ..., 2)."""
        ...

    def clearance(self, xy: Array, scenes: Counts | None = None) -> Array:
        """Distance [m], (M, ...), from points (M, ..., 2) to the nearest obstacle; `scenes` as above."""
        ...


class ProximityQueries(Protocol):
    """Clearances and neighbours of each group's agents at one control step, computed on first access."""

    def clearance(self, group: str) -> Array:
        """Distance [m], (N,), of each agent's outline from the nearest obstacle or other agent.

        The array is new at every call.
        """
        ...

    def gap(self, group: str, other: str) -> Array:
        """Distance [m], (N,), of each agent's outline from the nearest agent of the group `other` but itself.

        inf where there is none, 0 or less where outlines overlap.
        """
        ...

    def neighbours(self, group: str) -> Array:
        """Poses (N, K, 7) of the other moving bodies of each agent's scene: see `GroupState.neighbours`."""
        ...


class ScanQueries(Protocol):
    """A LiDAR that measures agents for terms, beside those that the agents see with."""

    def nearest_return(self, motion: "Motion", neighbours: Array) -> Array:
        """Smallest range [m], (N,), of a scan from each agent; NaN where no beam returns."""
        ...


class BatteryModel(Protocol):
    """The battery of a robot, for the terms that measure energy."""

    @property
    def capacity_wh(self) -> float:
        """Energy of a full battery [W h]."""
        ...

    def drawn_wh(self, work_j: Array, time_s: float) -> Array:
        """Energy [W h], (N,), drawn from the battery for motor work `work_j` (N,) [J] in `time_s` [s]."""
        ...


@dataclass(frozen=True)
class EnergyState:
    """The motors' work in this control step [J], (N,), and the battery that feeds them."""

    work_j: Array
    battery: BatteryModel

    def __post_init__(self) -> None:
        freeze(self.work_j)


@dataclass(frozen=True)
class JointState:
    """Angle [rad], speed [rad/s] and torque [N m] of the motors' joints, each (N, J).

    Positive values roll a wheel forward. Wheel angles are not wrapped. Torques are those of the motors in
    the last physics step.
    """

    angle: Array
    speed: Array
    torque: Array

    def __post_init__(self) -> None:
        for values in (self.angle, self.speed, self.torque):
            freeze(values)


class Motion:
    """True poses, velocities and accelerations of N bodies.

    `position_w` (N, 3) is the origin's [m]; `roll_pitch_yaw` (N, 3) [rad]; `rotation` (N, 3, 3) turns body
    to world; `velocity_w`, `angular_w` (N, 3) [m/s, rad/s] and the same in the body frame as `velocity_b`,
    `angular_b`; `acceleration_b` (N, 3) [m/s²] is the mean acceleration of the origin over the last control
    step without gravity; `joints` are the motors' joints, None if nothing reads them. `diverged` (N,) marks
    bodies whose physics gave an invalid state: they keep their last valid one.

    `frames` (N,) are the numbers of the frames in which sensors see bodies whose parts move (`MovingMesh`),
    and 0 for all others.

    Quantities that are not passed are computed on first access; those of rotation from `roll_pitch_yaw`.
    """

    position_w: Array
    roll_pitch_yaw: Array
    velocity_w: Array
    angular_w: Array
    diverged: Flags
    joints: JointState | None

    def __init__(
        self,
        position_w: Array,
        roll_pitch_yaw: Array,
        velocity_w: Array,
        angular_w: Array,
        diverged: Flags,
        joints: JointState | None = None,
        **derived: Array,
    ) -> None:
        """`derived` may have `rotation`, `velocity_b`, `angular_b`, `acceleration_b` and `frames`."""
        given = {
            "position_w": position_w,
            "roll_pitch_yaw": roll_pitch_yaw,
            "velocity_w": velocity_w,
            "angular_w": angular_w,
            "diverged": diverged,
            **derived,
        }
        for values in given.values():
            freeze(values)
        self.__dict__.update(given, joints=joints)

    def __setattr__(self, name: str, value: object) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}")

    @cached_property
    def rotation(self) -> Array:
        """Rotation matrices from body to world, (N, 3, 3)."""
        angles = self.roll_pitch_yaw
        return freeze(
            rotation_from_angles(angles) if angles[:, :2].any() else rotation_from_yaw(angles[:, 2])
        )

    @cached_property
    def velocity_b(self) -> Array:
        """Velocity of the origin in the body frame [m/s], (N, 3)."""
        return freeze(to_body(self.rotation, self.velocity_w))

    @cached_property
    def angular_b(self) -> Array:
        """Angular velocity in the body frame [rad/s], (N, 3)."""
        return freeze(to_body(self.rotation, self.angular_w))

    @cached_property
    def acceleration_b(self) -> Array:
        """Mean acceleration of the origin over the control step, in the body frame [m/s²], (N, 3)."""
        return freeze(np.zeros_like(self.velocity_w))

    @cached_property
    def frames(self) -> Array:
        """Numbers of the frames of the bodies' meshes, (N,), whole numbers."""
        return freeze(np.zeros(len(self.position_w)))

    @property
    def yaw(self) -> Array:
        """Heading [rad], (N,)."""
        return self.roll_pitch_yaw[:, 2]

    @cached_property
    def tilt(self) -> Array:
        """Angle between the body's z and the world's [rad], (N,)."""
        return freeze(np.arccos(np.minimum(np.maximum(self.rotation[:, 2, 2], -1.0), 1.0)))


@dataclass(frozen=True)
class GoalState:
    """Each agent's goal: `position_w` (N, 2) [m], its horizontal `distance` [m] now and one control step
    before, and its `bearing` (N,) [rad] from the agent's heading, in [-pi, pi).
    """

    position_w: Array
    distance: Array
    previous_distance: Array
    bearing: Array

    def __post_init__(self) -> None:
        for values in (self.position_w, self.distance, self.previous_distance, self.bearing):
            freeze(values)


@dataclass(frozen=True)
class ContactState:
    """Contacts with anything but the ground in any physics step of this control step, each (N,).

    `touching` marks agents in contact, `new` is the number of collisions that began (one per body touched,
    for however long), `total` the number of collisions in the episode. `new_by_kind` are those of `new` by
    the class of what was touched: static, robot, or the kind of a body such as person; classes without any
    are left out.
    """

    touching: Flags
    new: Counts
    total: Counts
    new_by_kind: Mapping[str, Counts] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for values in (self.touching, self.new, self.total, *self.new_by_kind.values()):
            freeze(values)
        object.__setattr__(self, "new_by_kind", MappingProxyType(self.new_by_kind))

    def begun(self, mask: Flags) -> "ContactState":
        """The contacts after episodes have begun in the rows in `mask` (N,), which have none."""
        return ContactState(
            self.touching & ~mask,
            np.where(mask, 0, self.new),
            np.where(mask, 0, self.total),
            {kind: np.where(mask, 0, new) for kind, new in self.new_by_kind.items()},
        )


@dataclass(frozen=True)
class EpisodeState:
    """Episode id and number of control steps of each agent.

    `ids` (N,) are the episodes' numbers, `steps` (N,) the control steps since their start, each of `step_s`
    [s]. Random draws of an agent depend on (`seed`, name, `streams` (N,), `steps`) alone: `streams` differ
    between the agents of a scene, and equal `ids` for agent 0.
    """

    seed: int
    ids: Counts
    steps: Counts
    streams: Counts
    step_s: float

    def __post_init__(self) -> None:
        for values in (self.ids, self.steps, self.streams):
            freeze(values)


@dataclass(frozen=True)
class GroupState:
    """One agent group after a control step; every array has the leading axis N = M * G.

    `body` describes what never changes. `done` (N,) marks agents whose own episode ended in an earlier step,
    or has not begun, while their scene's goes on. `episode.steps` of an agent that comes later count from
    then on. `absent` (N,) marks agents that have not come yet, or are gone: they are far outside of the
    world, at rest, and `done`; None where agents do not come and go. `energy` and `scanner` are None unless a
    term needs them. `last_action` (N, A) is the action of the last control step, -1 at the lower and 1 at the
    upper bounds of actions, and 0 at the start of an episode.

    `endings` has the flags (N,) of each termination term by name; it is empty for the
    terminations themselves, which are evaluated before rewards and metrics.
    """

    name: str
    count: int
    body: BodyDescription
    episode: EpisodeState
    motion: Motion
    contacts: ContactState
    goal: GoalState
    done: Flags
    proximity: ProximityQueries
    absent: Flags | None = None
    energy: EnergyState | None = None
    scanner: ScanQueries | None = None
    last_action: Array | None = None
    endings: Mapping[str, Flags] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self.done)
        if self.absent is not None:
            freeze(self.absent)
        if self.last_action is not None:
            freeze(self.last_action)

    @cached_property
    def nearest_return(self) -> Array:
        """Smallest range [m], (N,), of a scan as the paper's published code makes it; NaN where no beam
        returns.

        Raises ConfigError unless a term of the group has the attribute `needs_scan`.
        """
        if self.scanner is None:
            raise ConfigError(
                f"no scan is measured of {self.name}: give the term that reads it `needs_scan = True`"
            )
        return freeze(self.scanner.nearest_return(self.motion, self.neighbours))

    @cached_property
    def clearance(self) -> Array:
        """Distance [m], (N,), from each outline to the nearest obstacle or other agent; 0 on contact, inf
        without any.
        """
        apart = np.maximum(self.proximity.clearance(self.name), 0.0)
        apart[self.contacts.touching] = 0.0
        return freeze(apart)

    @cached_property
    def neighbours(self) -> Array:
        """Poses (N, K, 7) of the other moving bodies of each agent's scene.

        x, y, z [m], yaw, roll and pitch [rad], and the number of the frame of its mesh: see `Motion.frames`.
        """
        return freeze(self.proximity.neighbours(self.name))

    def ended_by(self, termination: str) -> Flags:
        """Flags (N,) of the termination term of this name; all False if the task has no such term."""
        flags = self.endings.get(termination)
        return np.zeros(len(self.done), bool) if flags is None else flags

    def by_scene(self, values: NDArray[Any]) -> NDArray[Any]:
        """`values` (N, ...) reshaped to (M, G, ...)."""
        return values.reshape(-1, self.count, *values.shape[1:])


@dataclass(frozen=True)
class State:
    """State of all agent groups of M scenes by name, and queries of the ground."""

    groups: Mapping[str, GroupState]
    ground: GroundQueries
    num_scenes: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "groups", MappingProxyType(self.groups))

    @cached_property
    def surroundings(self) -> Surroundings:
        """All bodies of each scene, and the obstacles nearest to them, for behaviours."""
        bodies = [
            GroupBodies(
                group.name,
                group.count,
                group.motion.position_w[:, :2],
                group.motion.velocity_w[:, :2],
                group.motion.yaw,
                group.body,
                group.absent,
            )
            for group in self.groups.values()
        ]
        return Surroundings(bodies, self.ground.clearance, self.ground.extents)

    def extents(self, group: GroupState) -> Array:
        """Rectangle (xmin, xmax, ymin, ymax) [m] of the terrain of each agent of `group`, (N, 4)."""
        extents = self.ground.extents
        return extents if group.count == 1 else np.repeat(extents, group.count, axis=0)
