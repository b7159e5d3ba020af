"""Kinematic bodies: N = M * G agents that follow prescribed motions on the ground, without dynamics."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_from_yaw, to_body, wrap_angle
from dune_rl.state import Motion
from dune_rl.worlds.batched_worlds import BatchedWorlds

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Agents keep this far from the world's edge [m].
_EDGE_M = 1.0


class KinematicBody:
    """N equal bodies with unicycle kinematics, rows scene after scene.

    `poses` (N, 4) are x, y, z on the ground [m] and yaw [rad]; `blocked` (N,) marks bodies
    that stopped in the last step in front of an obstacle or the world's edge.
    """

    def __init__(self, conf: PersonConf, worlds: BatchedWorlds, count: int, step_s: float) -> None:
        self.conf, self.count = conf, count
        self._worlds, self._step_s = worlds, step_s
        rows = len(worlds) * count
        self.poses = np.zeros((rows, 4))
        self.blocked = np.zeros(rows, bool)
        self._unblocked = np.zeros(rows, bool)
        still = np.zeros((rows, 3))
        self.motion = self._moving(still, still, still)
        self._before = self.poses, self.motion

    def action_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, each (2,), of speed [m/s] (never backwards) and relative heading [rad]."""
        return np.array([0.0, -np.pi]), np.array([self.conf.speed_mps, np.pi])

    def rest_action(self) -> Array:
        """Action (2,) at which the body stands still."""
        return np.zeros(2)

    def place(self, scene: int, poses: Array) -> None:
        """Put the bodies of a scene at `poses` (G, 4), at rest; `read_start` must follow."""
        rows = slice(scene * self.count, (scene + 1) * self.count)
        self.poses = self.poses.copy()
        self.poses[rows] = poses
        self.blocked[rows] = False

    def read_start(self, mask: Flags) -> None:
        """Set the motion in the rows in `mask` (N,) to rest."""
        before = self.motion
        velocity, turning, acceleration = (
            np.where(mask[:, None], 0.0, values)
            for values in (before.velocity_w, before.angular_w, before.acceleration_b)
        )
        self.motion = self._moving(velocity, turning, acceleration)

    def move_to(self, poses: Array) -> None:
        """Move to `poses` (N, 4) by the end of the control step."""
        self._arrive(poses)

    def apply_actions(self, actions: Array) -> None:
        """Move for a control step by `actions` (N, 2): speed [m/s] and relative heading [rad].

        Both are clipped to the limits of the body. A body in front of an obstacle turns in place; one that a
        robot has pushed into an obstacle may move where it is less deep in it.
        """
        conf, poses = self.conf, self.poses.copy()
        most = conf.max_turn_radps * self._step_s
        turn = np.clip(actions[:, 1], -most, most)
        yaw = wrap_angle(poses[:, 3] + turn)
        distance = np.clip(actions[:, 0], 0.0, conf.speed_mps) * self._step_s
        target = poses[:, :2] + distance[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        by_scene = target.reshape(-1, self.count, 2)
        xmin, xmax, ymin, ymax = self._worlds.extents.T[:, :, None]
        inside = (
            (by_scene[..., 0] > xmin + _EDGE_M)
            & (by_scene[..., 0] < xmax - _EDGE_M)
            & (by_scene[..., 1] > ymin + _EDGE_M)
            & (by_scene[..., 1] < ymax - _EDGE_M)
        )
        clearance = self._worlds.clearance(by_scene)
        free = clearance >= conf.radius_m
        if not free.all():
            free |= clearance > self._worlds.clearance(poses[:, :2].reshape(-1, self.count, 2))
        free = (free & inside).ravel()
        poses[:, :2] = np.where(free[:, None], target, poses[:, :2])
        poses[:, 2] = self._worlds.height(poses[:, :2].reshape(-1, self.count, 2)).ravel()
        poses[:, 3] = yaw
        self._arrive(poses)
        self.blocked = ~free

    def hold_back(self, scenes: Sequence[int], poses: Array) -> None:
        """Set x and y of the bodies of `scenes` (S) to those of `poses` (S, G, 4), after robots blocked
        bodies.
        """
        reached = self.poses.copy()
        reached.reshape(-1, self.count, 4)[list(scenes), :, :2] = poses[..., :2]
        moved = (reached[:, :2] != self.poses[:, :2]).any(axis=1)
        height = self._worlds.height(reached[:, :2].reshape(-1, self.count, 2)).ravel()
        reached[:, 2] = np.where(moved, height, reached[:, 2])
        self.poses, self.motion = self._before
        self._arrive(reached)

    def _arrive(self, poses: Array) -> None:
        """Be at `poses` (N, 4), with the mean velocities of the way there and their change."""
        self._before = before, motion = self.poses, self.motion
        self.poses = poses
        turning = np.zeros((len(poses), 3))
        velocity = (poses[:, :3] - before[:, :3]) / self._step_s
        turning[:, 2] = wrap_angle(poses[:, 3] - before[:, 3]) / self._step_s
        acceleration = (velocity - motion.velocity_w) / self._step_s
        self.motion = self._moving(velocity, turning, to_body(rotation_from_yaw(poses[:, 3]), acceleration))

    def _moving(self, velocity_w: Array, angular_w: Array, acceleration_b: Array) -> Motion:
        attitude = np.zeros((len(self.poses), 3))
        attitude[:, 2] = self.poses[:, 3]
        place = self.poses[:, :3]
        return Motion(place, attitude, velocity_w, angular_w, self._unblocked, acceleration_b=acceleration_b)
