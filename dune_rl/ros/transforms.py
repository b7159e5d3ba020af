"""Frames of ROS (REP-103 axes, REP-105 names) and the transforms between them."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import rotation_from_angles, rotation_matrices
from dune_rl.ros.times import stamp_ns

_MOST_STRETCH = 0.01
MAP, ODOM, BASE = "map", "odom", "base_link"
# From axes of a body (x forward, y left, z up) to those of pictures (x right, y down, z forward).
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class Pose(NamedTuple):
    """Where a frame is in another one: its origin (3,) [m], and the rotation (3, 3) to that one's axes."""

    position: Array
    rotation: Array

    def __matmul__(self, inner: "Pose") -> "Pose":
        """The pose of a frame that is at `inner` in this one."""
        return Pose(self.position + self.rotation @ inner.position, self.rotation @ inner.rotation)

    @property
    def inverse(self) -> "Pose":
        """The pose of the other frame in this one."""
        return Pose(-self.rotation.T @ self.position, self.rotation.T)


ORIGIN = Pose(np.zeros(3), np.eye(3))


@dataclass(frozen=True)
class FrameMount:
    """A fixed frame: `name` is at `pose` in `parent`."""

    parent: str
    name: str
    pose: Pose

    @classmethod
    def on_base(cls, name: str, mount_b: Iterable[float] | None, pitch_rad: float = 0.0) -> "FrameMount":
        """A frame on the body, pitched down by `pitch_rad`; the body's own origin without `mount_b`."""
        position = np.zeros(3) if mount_b is None else np.array(list(mount_b), np.float64)
        return cls(BASE, name, Pose(position, rotation_from_angles(np.array([0.0, pitch_rad, 0.0]))))


def is_rotation(quaternion: Any) -> bool:
    """Whether a Quaternion message has the length 1, as nearly as tf2 asks; zeros stand for none."""
    length = math.hypot(quaternion.x, quaternion.y, quaternion.z, quaternion.w)
    return abs(length - 1.0) < _MOST_STRETCH


def rotation_of(quaternion: Any) -> Array:
    """Rotation matrix (3, 3) of a Quaternion message."""
    return rotation_matrices(np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w]))


class TransformTree:
    """The latest transforms of /tf and /tf_static, by their child frames."""

    def __init__(self) -> None:
        # The parent of each frame, and its pose there.
        self._parents: dict[str, tuple[str, Pose]] = {}
        # Times [ns] of the transforms that change.
        self._stamps: dict[str, int] = {}

    def add(self, message: Any, *, is_static: bool = False) -> None:
        """Take the transforms of a TFMessage, of /tf_static if it `is_static`; no malformed ones."""
        for each in message.transforms:
            moved, turned = each.transform.translation, each.transform.rotation
            position = np.array([moved.x, moved.y, moved.z])
            if not (is_rotation(turned) and np.isfinite(position).all()):
                continue
            parent, child = (name.lstrip("/") for name in (each.header.frame_id, each.child_frame_id))
            self._parents[child] = parent, Pose(position, rotation_of(turned))
            if not is_static:
                self._stamps[child] = stamp_ns(each.header.stamp)

    def pose(self, frame: str, reference: str) -> Pose | None:
        """The pose of `frame` in `reference`, above it; None where no transforms lead there.

        A frame is at its own origin.
        """
        way = self._way(frame, reference)
        if way is None:
            return None
        found = ORIGIN
        for at in way:
            found = self._parents[at][1] @ found
        return found

    def oldest_ns(self, frame: str, reference: str) -> int | None:
        """The time [ns] of the oldest changing transform from `frame` to `reference`; None without one."""
        times = [self._stamps[at] for at in self._way(frame, reference) or () if at in self._stamps]
        return min(times, default=None)

    def forget_changing(self) -> None:
        """Drop the transforms that are not static."""
        for child in self._stamps:
            del self._parents[child]
        self._stamps.clear()

    def _way(self, frame: str, reference: str) -> list[str] | None:
        """The frames from `frame` up to below `reference`; None where none leads there."""
        found: list[str] = []
        at = frame.lstrip("/")
        while at != reference.lstrip("/"):
            if at not in self._parents or at in found:
                return None
            found.append(at)
            at = self._parents[at][0]
        return found
