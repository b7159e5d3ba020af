"""Kinematic bodies: N = M * G agents that follow prescribed motions on the ground, without dynamics."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.bodies.person import PersonConf
from dune_rl.compiled import compile_function
from dune_rl.env.body import Engines
from dune_rl.env.proximity import Outline
from dune_rl.geometry.frames import wrap_angle
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.robots.robot import BodyMotion
from dune_rl.sensors.context import SensorCarrier
from dune_rl.state import Motion
from dune_rl.worlds.batched_worlds import BatchedWorlds

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Scenes = NDArray[np.int64]

# Agents keep this far from the world's edge [m].
_EDGE_M = 1.0


class KinematicBody:
    """N equal bodies with unicycle kinematics, rows scene after scene: a `Body` without physics.

    `poses` (N, 4) are x, y, z on the ground [m] and yaw [rad], from a command on those of the end of its
    control step; `motion` is derived from them by `read`. `blocked` (N,) marks bodies that stopped in the
    last step in front of an obstacle or the world's edge.
    """

    def __init__(self, conf: PersonConf, worlds: BatchedWorlds, count: int, step_s: float) -> None:
        self.conf, self.count = conf, count
        self._worlds, self.step_s = worlds, step_s
        rows = len(worlds) * count
        self.poses = np.zeros((rows, 4))
        self.blocked = np.zeros(rows, bool)
        self._unblocked = np.zeros(rows, bool)
        still = np.zeros((rows, 3))
        self.motion = self._moving(still, still, still)
        self._start_poses = self.poses
        self.outline = Outline.disc(conf.radius_m)
        self.radius_m, self.height_m = conf.radius_m, conf.height_m
        self.wheel_radius_m, self.energy, self.reads_joints = None, None, False

    def action_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, each (2,), of speed [m/s] (never backwards) and relative heading [rad]."""
        return np.array([0.0, -np.pi]), np.array([self.conf.speed_mps, np.pi])

    def rest_action(self) -> Array:
        """Action (2,) at which the body stands still."""
        return np.zeros(2)

    def carrier(self) -> SensorCarrier:
        """The body as a carrier of sensors."""
        return self.conf.carrier()

    def mesh(self) -> MovingMesh:
        """What the sensors of others see."""
        return self.conf.mesh()

    def reset(self, mask: Flags) -> None:
        """Nothing is kept from one episode to the next."""

    def place(self, scene: int, poses: Array) -> None:
        """Put the bodies of a scene at `poses` (G, 4), at rest; `read_start` must follow."""
        rows = slice(scene * self.count, (scene + 1) * self.count)
        self.poses = self.poses.copy()
        self.poses[rows] = poses
        self.blocked[rows] = False

    def read_start(self, mask: Flags, engines: Engines = ()) -> None:
        """Set the motion in the rows in `mask` (N,) to rest."""
        before = self.motion
        velocity, turning, acceleration = (
            np.where(mask[:, None], 0.0, values)
            for values in (before.velocity_w, before.angular_w, before.acceleration_b)
        )
        self.motion = self._moving(velocity, turning, acceleration)

    def move_to(self, poses: Array) -> None:
        """Move to `poses` (N, 4) by the end of the control step."""
        self._start_poses, self.poses = self.poses, poses

    def command(self, actions: Array, known: BodyMotion, engines: Engines = ()) -> None:
        """Move for a control step by `actions` (N, 2): speed [m/s] and relative heading [rad].

        Both are clipped to the limits of the body. A body in front of an obstacle turns in place; one that a
        robot has pushed into an obstacle may move where it is less deep in it. It needs no measured motion
        (`known`) and no `engines`.
        """
        conf, poses = self.conf, self.poses.copy()
        most = conf.max_turn_radps * self.step_s
        turn = np.clip(actions[:, 1], -most, most)
        yaw = wrap_angle(poses[:, 3] + turn)
        distance = np.clip(actions[:, 0], 0.0, conf.speed_mps) * self.step_s
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
        self.move_to(poses)
        self.blocked = ~free

    def hold_back(self, scenes: Scenes, poses: Array) -> None:
        """Set x and y of the bodies of `scenes` (S,) to those of `poses` (S, G, 6), after robots blocked
        bodies.
        """
        reached = self.poses.copy()
        heights = self._worlds.height(poses[..., :2], scenes)
        _set_reached(reached.reshape(-1, self.count, 4), scenes, poses, heights)
        self.poses = reached

    def read(self, engines: Engines = ()) -> list[tuple[int, int]]:
        """Derive the motion at the end of a control step: its mean velocities, and their change.

        Returns no contacts: these bodies have those that robots have with them.
        """
        found = np.zeros((3, len(self.poses), 3))
        _derive_motion(self.poses, self._start_poses, self.motion.velocity_w, self.step_s, found)
        velocity_w, angular_w, acceleration_b = found
        self.motion = self._moving(velocity_w, angular_w, acceleration_b)
        return []

    def _moving(self, velocity_w: Array, angular_w: Array, acceleration_b: Array) -> Motion:
        attitude = np.zeros((len(self.poses), 3))
        attitude[:, 2] = self.poses[:, 3]
        place = self.poses[:, :3]
        return Motion(place, attitude, velocity_w, angular_w, self._unblocked, acceleration_b=acceleration_b)


@compile_function
def _set_reached(poses: Any, scenes: Any, reached: Any, heights: Any) -> None:
    """Move those of `poses` (M, G, 4) to the x and y of `reached` (S, G, 6) that differ, in `scenes` (S,).

    `heights` (S, G) are the ground's at `reached`.
    """
    for row in range(len(scenes)):
        for agent in range(poses.shape[1]):
            pose, place = poses[scenes[row], agent], reached[row, agent]
            if pose[0] != place[0] or pose[1] != place[1]:
                pose[0], pose[1], pose[2] = place[0], place[1], heights[row, agent]


@compile_function
def _derive_motion(poses: Any, before: Any, velocity_before: Any, step_s: float, found: Any) -> None:
    """Velocities (N, 3), turning rates (N, 3) and, in the body frame, accelerations (N, 3), into `found`.

    Bodies went from `before` (N, 4) to `poses` (N, 4), and had the mean velocities `velocity_before` (N, 3).
    """
    velocity, turning, acceleration = found[0], found[1], found[2]
    for row in range(len(poses)):
        for axis in range(3):
            velocity[row, axis] = (poses[row, axis] - before[row, axis]) / step_s
        turn = (poses[row, 3] - before[row, 3] + np.pi) % (2 * np.pi) - np.pi
        turning[row, 2] = turn / step_s
        x = (velocity[row, 0] - velocity_before[row, 0]) / step_s
        y = (velocity[row, 1] - velocity_before[row, 1]) / step_s
        cos, sin = np.cos(poses[row, 3]), np.sin(poses[row, 3])
        acceleration[row, 0] = cos * x + sin * y
        acceleration[row, 1] = cos * y - sin * x
        acceleration[row, 2] = (velocity[row, 2] - velocity_before[row, 2]) / step_s
