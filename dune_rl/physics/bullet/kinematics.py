"""Kinematic bodies of a PyBullet scene, and how hard they push."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.physics.bullet.client import pybullet
from dune_rl.physics.bullet.robot import BulletRobot
from dune_rl.physics.shapes import KINEMATIC_FRICTION, KinematicBox, KinematicShape

# Between those of abdomen and thigh, 10 and 50 N/mm, in ISO/TS 15066. At 1 m/s the force grows by 100 N in a
# physics step of 5 ms, which is how far it can exceed the limit.
STIFFNESS_NPM, DAMPING_NSPM = 20e3, 200.0


class Push:
    """Horizontal force of a kinematic body on robots in a physics step, over all contact points."""

    def __init__(self) -> None:
        self._x = self._y = self._moment_nm = self._power_w = self._fastest_mps = self._farthest_m = 0.0
        self._points = 0

    def add(
        self, x: float, y: float, arm_x: float, arm_y: float, arm_m: float, speed_x: float, speed_y: float
    ) -> None:
        """Add the force (x, y) [N] at a point of a robot that moves with a velocity (x, y) [m/s].

        The point is at `arm_x` and `arm_y` [m] from the body's origin, `arm_m` away.
        """
        self._x += x
        self._y += y
        self._points += 1
        self._moment_nm += arm_x * y - arm_y * x
        self._power_w += x * speed_x + y * speed_y
        speed_mps = math.hypot(speed_x, speed_y)
        if speed_mps > self._fastest_mps:
            self._fastest_mps = speed_mps
        if arm_m > self._farthest_m:
            self._farthest_m = arm_m

    def retreat_m(
        self, way_x: float, way_y: float, turn_rad: float, limit_n: float, timestep_s: float
    ) -> tuple[float, float]:
        """Way (x, y) [m] that the body has to step back, so as not to push harder than `limit_n` next.

        It is about to advance by `way_x` and `way_y` [m] and to turn by `turn_rad`, and the robots move on.
        """
        force_n = math.hypot(self._x, self._y)
        # Robots on two sides may push with forces that cancel: then nothing pushes it away.
        if not force_n > 0.0:
            return 0.0, 0.0
        work_j = way_x * self._x + way_y * self._y - self._power_w * timestep_s
        swept_m = 0.0
        if turn_rad:
            work_j += turn_rad * self._moment_nm
            swept_m = abs(turn_rad) * self._farthest_m
        # Of one robot it is never more; of two whose forces nearly cancel it could be anything.
        fastest_m = 1.001 * (math.hypot(way_x, way_y) + swept_m + self._fastest_mps * timestep_s)
        closing_m = min(max(work_j / force_n, -fastest_m), fastest_m)
        excess_m = closing_m + (force_n - limit_n) / (self._points * STIFFNESS_NPM)
        if not excess_m > 0.0:
            return 0.0, 0.0
        return excess_m * self._x / force_n, excess_m * self._y / force_n


# Bodies that are not near any robot are moved out of the way once, and not at all after that.
_ASIDE_POSE = [0.0, 0.0, -1e4, 0.0, 0.0, 0.0]

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class BulletKinematics:
    """The kinematic bodies of a PyBullet client, in collision `group` with `mask`.

    PyBullet moves them whatever is in their way. So that they push with a limited force, their contacts are
    springs: after each physics step in which the force is above the limit, a body is set back by as much as
    brings it down to the limit.

    `poses` (K, 6: x, y, z, yaw, roll, pitch) are those at the end of the last control step,
    and `any_held_back` whether robots held any of the bodies back in it.
    """

    def __init__(self, client: int, shapes: Sequence[KinematicShape], group: int, mask: int) -> None:
        self._client, self._shapes = client, shapes
        self.handles = [self._add(shape, group, mask) for shape in shapes]
        self._centre_heights = [shape.centre_height_m for shape in shapes]
        self._leans = [isinstance(shape, KinematicBox) for shape in shapes]
        self._in_place = set(range(len(shapes)))
        self._indices = {handle: index for index, handle in enumerate(self.handles)}
        self.poses: Array = np.zeros((len(shapes), 6))
        self.any_held_back = False
        # Of bodies near robots: where they are before this control step and how far they go in it (x, y, z)
        # [m], and their attitude; that of boxes changes in the step, from one to another yaw, roll and pitch.
        self._ways: dict[int, tuple[Triple, Triple, Quaternion | None]] = {}
        self._angles: dict[int, tuple[list[float], list[float]]] = {}
        # Of bodies that move in this control step: x and y of the origin, and the centre.
        self._positions: dict[int, tuple[float, float]] = {}
        self._centres: dict[int, tuple[float, float, float]] = {}
        self._offsets: dict[int, tuple[float, float]] = {}
        self._pushes: dict[int, Push] = {}

    def _add(self, shape: KinematicShape, group: int, mask: int) -> int:
        if isinstance(shape, KinematicBox):
            half = [side / 2 for side in shape.size_m]
            solid = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=half, physicsClientId=self._client
            )
        else:
            solid = pybullet.createCollisionShape(
                pybullet.GEOM_CAPSULE,
                radius=shape.radius_m,
                height=shape.height_m - 2 * shape.radius_m,
                physicsClientId=self._client,
            )
        handle: int = pybullet.createMultiBody(0.0, solid, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(handle, -1, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            handle,
            -1,
            lateralFriction=KINEMATIC_FRICTION,
            contactStiffness=STIFFNESS_NPM,
            contactDamping=DAMPING_NSPM,
            physicsClientId=self._client,
        )
        return handle

    def reset(self, poses: Array) -> None:
        """Put the bodies at `poses` (K, 6)."""
        self.poses, self.any_held_back = poses.copy(), False
        for index, pose in enumerate(poses.tolist()):
            self._put(index, pose)
        self._in_place = set(range(len(poses)))

    def place(self, index: int, pose: Array) -> None:
        """Have a body begin its next motion at a `pose` (6)."""
        self.poses = self.poses.copy()
        self.poses[index] = pose
        self._put_aside({index} & self._in_place)

    def begin_step(self, poses: Array, near: Sequence[int]) -> None:
        """Start the motion to `poses` (K, 6) of the bodies whose indices are in `near`; remove all others."""
        old, self.poses = self.poses, poses.copy()
        self._offsets.clear()
        self._put_aside(self._in_place.difference(near))
        self._in_place.update(near)
        self._ways.clear()
        for index in near:
            (x, y, z, *before), (new_x, new_y, new_z, *after) = old[index].tolist(), poses[index].tolist()
            attitude = None
            if self._leans[index]:
                self._angles[index] = before, after
            else:
                attitude = _turn(after[0])
            self._ways[index] = (x, y, z), (new_x - x, new_y - y, new_z - z), attitude

    def _put_aside(self, indices: set[int]) -> None:
        for index in sorted(indices):
            self._put(index, _ASIDE_POSE)
        self._in_place -= indices

    def move(self, share: float) -> None:
        """Put the bodies near robots at `share` of the way that they move, turn and lean in this control
        step.
        """
        for index, ((x, y, z), (way_x, way_y, way_z), attitude) in self._ways.items():
            x, y, z = x + way_x * share, y + way_y * share, z + way_z * share
            if index in self._offsets:
                back_x, back_y = self._offsets[index]
                x, y = x + back_x, y + back_y
            self._positions[index] = x, y
            if attitude is None:
                before, after = self._angles[index]
                yaw = before[0] + _turned(before[0], after[0]) * share
                roll, pitch = (
                    one + (other - one) * share for one, other in zip(before[1:], after[1:], strict=True)
                )
                self._centres[index] = self._put(index, [x, y, z, yaw, roll, pitch])
                continue
            position = x, y, z + self._centre_heights[index]
            pybullet.resetBasePositionAndOrientation(self.handles[index], position, attitude, self._client)

    def record_contacts(self, contacts: Sequence[tuple[Any, ...]], robot: BulletRobot) -> None:
        """Take note of contact points of a robot in the last physics step, as PyBullet lists them."""
        velocity = None
        for contact in contacts:
            index, force_n = self._indices.get(contact[2]), contact[9]
            if index is None or not force_n > 0.0:
                continue
            (point_x, point_y, _), (axis_x, axis_y) = contact[6], self._positions[index]
            arm_x, arm_y = point_x - axis_x, point_y - axis_y
            arm_m = math.hypot(arm_x, arm_y)
            if self._leans[index]:
                x, y = _outward(contact[7], contact[6], self._centres[index])
                length = 1.0
            else:
                # From the axis of the capsule to the point on its surface.
                x, y, length = arm_x, arm_y, arm_m
            if length > 0.0:
                # One call into the engine for all points of the step.
                velocity = velocity or robot.velocity_xy()
                if (push := self._pushes.get(index)) is None:
                    push = self._pushes[index] = Push()
                push.add(force_n * x / length, force_n * y / length, arm_x, arm_y, arm_m, *velocity)

    @property
    def moves_any(self) -> bool:
        """Whether any bodies move in this control step: those near robots."""
        return bool(self._ways)

    @property
    def are_pushing(self) -> bool:
        """Whether contact points were recorded since the last `yield_to_robots`."""
        return bool(self._pushes)

    def yield_to_robots(self, share: float, timestep_s: float) -> None:
        """Set back the bodies that would push harder than they may in the next physics step.

        They are about to move by `share` of their way in this control step.
        """
        for index, push in self._pushes.items():
            _, (way_x, way_y, _), _ = self._ways[index]
            turn = 0.0
            if self._leans[index]:
                before, after = self._angles[index]
                turn = share * _turned(before[0], after[0])
            back_x, back_y = push.retreat_m(
                share * way_x, share * way_y, turn, self._shapes[index].max_push_n, timestep_s
            )
            if back_x or back_y:
                x, y = self._offsets.get(index, (0.0, 0.0))
                self._offsets[index] = x - back_x, y - back_y
        self._pushes.clear()

    def end_step(self) -> None:
        """Update the poses of bodies that were held back."""
        for index, offset in self._offsets.items():
            self.poses[index, :2] += offset
        self.any_held_back = bool(self._offsets)

    def _put(self, index: int, pose: Sequence[float]) -> tuple[float, float, float]:
        """Put a body at a pose (6); returns its centre (3) [m]."""
        x, y, z, yaw, roll, pitch = pose
        height = self._centre_heights[index]
        attitude, centre = _turn(yaw), (x, y, z + height)
        if self._leans[index] and (roll or pitch):
            attitude = _attitude(yaw, roll, pitch)
            up_x, up_y, up_z = _up(attitude)
            centre = x + up_x * height, y + up_y * height, z + up_z * height
        pybullet.resetBasePositionAndOrientation(
            self.handles[index], centre, attitude, physicsClientId=self._client
        )
        return centre


def _turn(yaw: float) -> Quaternion:
    """Quaternion xyzw of a yaw [rad]."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _attitude(yaw: float, roll: float, pitch: float) -> Quaternion:
    """Quaternion xyzw of roll, then pitch, then yaw [rad]."""
    sr, cr = math.sin(roll / 2), math.cos(roll / 2)
    sp, cp = math.sin(pitch / 2), math.cos(pitch / 2)
    sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
    return (
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
        cy * cp * cr + sy * sp * sr,
    )


def _up(attitude: Quaternion) -> tuple[float, float, float]:
    """The z axis of a body in the world frame (3)."""
    x, y, z, w = attitude
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


def _turned(old: float, new: float) -> float:
    """The smaller angle [rad] from one yaw to another."""
    return (new - old + math.pi) % (2.0 * math.pi) - math.pi


def _outward(normal: Sequence[float], point: Sequence[float], centre: Sequence[float]) -> tuple[float, float]:
    """X and y of the `normal` (3) of a box at a point (3) on its surface, from inside to outside.

    PyBullet's normals may have either sense.
    """
    ways = zip(normal, point, centre, strict=True)
    sense = math.copysign(1.0, sum(part * (here - middle) for part, here, middle in ways))
    return sense * normal[0], sense * normal[1]
