"""A URDF as data: links with masses and shapes, and the tree of joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from trimesh.transformations import rotation_matrix, translation_matrix

from dune_rl.core.errors import RobotError
from dune_rl.geometry.arrays import Array


@dataclass(frozen=True)
class UrdfHints:
    """What <transmission>, <ros2_control> and <gazebo> elements say.

    `commanded` are joints that some controller commands; `plugins` are names and file names of plugins.
    `diagonal_grip` are links whose friction acts along a diagonal (`fdir1`), `no_grip` those without any.
    """

    commanded: frozenset[str] = frozenset()
    plugins: tuple[str, ...] = ()
    diagonal_grip: frozenset[str] = frozenset()
    no_grip: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], in the axes of a frame."""

    mass: float
    centre: Array
    inertia: Array

    def transform(self, pose: Array) -> "Inertial":
        """The same in the frame in which this one's frame has `pose` (4, 4)."""
        turn = pose[:3, :3]
        return Inertial(self.mass, turn @ self.centre + pose[:3, 3], turn @ self.inertia @ turn.T)


@dataclass(frozen=True, eq=False)
class Geometry:
    """A box, cylinder (along z), sphere or mesh, at `pose` (4, 4) in its link.

    `size` is (3,) lengths, (radius, length), (radius,), or a mesh's (3,) scale. `colour` (sRGB) is its
    material's, None without one.
    """

    kind: str
    size: tuple[float, ...]
    pose: Array
    mesh: str | None
    colour: tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class Link:
    """A link; `inertial` is None without mass."""

    name: str
    inertial: Inertial | None
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint whose `kind` is "fixed", "continuous", "revolute" or "prismatic".

    `pose` (4, 4) is the child's in the parent's frame with the joint at zero, `axis` (3,) a unit vector in
    the child's frame. `limits` are the lowest and the highest position [m or rad]. `effort` and `velocity`
    are None if the URDF has no limit; `mimic` is the name of the joint that this one follows, and the ratio
    of their angles.
    """

    name: str
    kind: str
    parent: str
    child: str
    pose: Array
    axis: Array
    limits: tuple[float, float]
    effort: float | None
    velocity: float | None
    friction: float
    damping: float
    mimic: tuple[str, float] | None

    @property
    def rest(self) -> float:
        """Position at rest [m or rad]: zero, or the limit nearest to zero."""
        return min(max(0.0, self.limits[0]), self.limits[1]) if self.is_limited else 0.0

    @property
    def is_limited(self) -> bool:
        """Whether `limits` apply."""
        return self.kind in ("revolute", "prismatic")

    def motion(self, position: float) -> Array:
        """Motion (4, 4) of the child at a position [m or rad]."""
        if self.kind == "fixed":
            return np.eye(4)
        slides = self.kind == "prismatic"
        return np.asarray(
            translation_matrix(position * self.axis) if slides else rotation_matrix(position, self.axis)
        )


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """Links and joints of a robot by name; `root` is the base link's, and `hints` what other elements say."""

    path: Path
    name: str
    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    hints: UrdfHints = field(default_factory=UrdfHints)

    def joints_above(self, link: str) -> list[Joint]:
        """The joints between the root and `link`, the root's first."""
        found: list[Joint] = []
        while link in self._by_child:
            found.append(self._by_child[link])
            link = found[-1].parent
        return found[::-1]

    @cached_property
    def _by_child(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    def fault(self, text: str) -> RobotError:
        """An error about the file."""
        return RobotError(f"{self.path.name}: {text}")

    def axis_b(self, joint: Joint) -> Array:
        """Axis (3,) of a joint in the root's frame with all joints at rest."""
        axis: Array = self.pose_b(joint.child)[:3, :3] @ joint.axis
        return axis

    def list_moving_joints(self) -> str:
        """The joints that are not fixed, for messages."""
        moving = [f"{joint.name} ({joint.kind})" for joint in self.joints.values() if joint.kind != "fixed"]
        return ", ".join(moving) or "no joints that move"

    def pose_b(self, link: str) -> Array:
        """Pose (4, 4) of `link` in the root's frame with all joints at rest."""
        return self._poses_b[link]

    @cached_property
    def _poses_b(self) -> dict[str, Array]:
        return self.link_poses(np.eye(4), {joint.name: joint.rest for joint in self.joints.values()})

    def link_poses(self, base: Array, positions: Mapping[str, float]) -> dict[str, Array]:
        """Poses (4, 4) of the links, by name, with the root at `base` and joints at `positions` [m or rad].

        Joints that are not named are at zero.
        """
        poses, parents = {self.root: base}, [self.root]
        while parents:
            parent = parents.pop()
            for joint in self.child_joints(parent):
                poses[joint.child] = poses[parent] @ joint.pose @ joint.motion(positions.get(joint.name, 0.0))
                parents.append(joint.child)
        return poses

    def child_joints(self, link: str) -> Sequence[Joint]:
        """The joints whose parent is `link`, in the file's order."""
        return self._by_parent.get(link, ())

    @cached_property
    def _by_parent(self) -> dict[str, list[Joint]]:
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        return children
