"""Kinematic bodies of a PyBullet scene."""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import KINEMATIC_FRICTION, KinematicCapsule
from dune_rl.physics.stderr import suppress_stderr

with suppress_stderr():
    import pybullet

# Between those of abdomen and thigh, 10 and 50 N/mm, in ISO/TS 15066. At 1 m/s the force grows by 100 N in a
# physics step of 5 ms, which is how far it can exceed the limit.
_STIFFNESS_NPM, _DAMPING_NSPM = 20e3, 200.0

# Bodies that are not near any robot are moved out of the way once, and not at all after that.
_PARKING_POSE = [0.0, 0.0, -1e4, 0.0]


class PushedRobot(Protocol):
    """What a capsule needs to know of a robot that it pushes."""

    def velocity_xy(self) -> tuple[float, float]:
        """Present horizontal velocity [m/s]."""
        ...


class _Push:
    """Horizontal force of a capsule on robots in a physics step, over all contact points."""

    def __init__(self) -> None:
        self._x = self._y = self._power_w = self._fastest_mps = 0.0
        self._points = 0

    def add(self, x: float, y: float, velocity: tuple[float, float]) -> None:
        """Add the force (x, y) [N] at a point of a robot with a horizontal velocity [m/s]."""
        self._x, self._y, self._points = self._x + x, self._y + y, self._points + 1
        self._power_w += x * velocity[0] + y * velocity[1]
        self._fastest_mps = max(self._fastest_mps, math.hypot(*velocity))

    def retreat_m(self, advance_m: Sequence[float], limit_n: float, timestep_s: float) -> tuple[float, float]:
        """Way (x, y) [m] that the capsule has to step back, so as not to push harder than `limit_n` next.

        It is about to advance by `advance_m` (x, y), and the robots move on.
        """
        force_n = math.hypot(self._x, self._y)
        # Robots on two sides may push with forces that cancel: then nothing pushes it away.
        if not force_n > 0.0:
            return 0.0, 0.0
        closing_m = (advance_m[0] * self._x + advance_m[1] * self._y - self._power_w * timestep_s) / force_n
        # Of one robot it is never more; of two whose forces nearly cancel it could be anything.
        fastest_m = 1.001 * (math.hypot(*advance_m) + self._fastest_mps * timestep_s)
        closing_m = min(max(closing_m, -fastest_m), fastest_m)
        excess_m = closing_m + (force_n - limit_n) / (self._points * _STIFFNESS_NPM)
        if not excess_m > 0.0:
            return 0.0, 0.0
        return excess_m * self._x / force_n, excess_m * self._y / force_n


class BulletCapsules:
    """The kinematic capsules of a PyBullet client, in collision `group` with `mask`.

    PyBullet moves them whatever is in their way. So that they push with a
    limited force, their contacts are springs: after each physics step in which
    the force is above the limit, a capsule is set back by as much as brings it
    down to the limit.

    `poses` (K, 4: x, y, z, yaw) are those at the end of the last control step,
    and `any_held_back` whether robots held any of the capsules back in it.
    """

    def __init__(self, client: int, bodies: Sequence[KinematicCapsule], group: int, mask: int) -> None:
        self._client = client
        self.handles = [self._add(body, group, mask) for body in bodies]
        self._centre_heights = [body.height_m / 2 for body in bodies]
        self._parked = [False] * len(bodies)
        self._limits_n = [body.max_push_n for body in bodies]
        self._indices = {handle: index for index, handle in enumerate(self.handles)}
        self.poses: list[list[float]] = [[0.0] * 4 for _ in bodies]
        self.any_held_back = False
        self._old = self.poses
        self._attitudes: dict[int, tuple[float, float, float, float]] = {}
        self._positions: dict[int, tuple[float, float]] = {}
        self._offsets: dict[int, tuple[float, float]] = {}
        self._pushes: dict[int, _Push] = {}

    def _add(self, body: KinematicCapsule, group: int, mask: int) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CAPSULE,
            radius=body.radius_m,
            height=body.height_m - 2 * body.radius_m,
            physicsClientId=self._client,
        )
        handle: int = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(handle, -1, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            handle,
            -1,
            lateralFriction=KINEMATIC_FRICTION,
            contactStiffness=_STIFFNESS_NPM,
            contactDamping=_DAMPING_NSPM,
            physicsClientId=self._client,
        )
        return handle

    def reset(self, poses: NDArray[np.float64]) -> None:
        """Put the bodies at `poses` (K, 4)."""
        self.poses, self.any_held_back = poses.tolist(), False
        for index, pose in enumerate(self.poses):
            self._move(index, pose)
            self._parked[index] = False

    def begin_step(self, poses: list[list[float]], near: Sequence[int]) -> None:
        """Start the motion to `poses` (K, 4) of the bodies whose indices are in `near`; remove all others."""
        self._old, self.poses = self.poses, poses
        self._offsets.clear()
        for index, is_parked in enumerate(self._parked):
            if index in near:
                self._parked[index] = False
                self._attitudes[index] = _attitude(poses[index][3])
            elif not is_parked:
                self._move(index, _PARKING_POSE)
                self._parked[index] = True

    def move(self, index: int, share: float) -> None:
        """Put a body at `share` of the way that it moves in this control step."""
        (old_x, old_y, old_z, _), (x, y, z, _) = self._old[index], self.poses[index]
        x, y, z = old_x + (x - old_x) * share, old_y + (y - old_y) * share, old_z + (z - old_z) * share
        if index in self._offsets:
            back_x, back_y = self._offsets[index]
            x, y = x + back_x, y + back_y
        self._positions[index] = x, y
        position = x, y, z + self._centre_heights[index]
        pybullet.resetBasePositionAndOrientation(
            self.handles[index], position, self._attitudes[index], self._client
        )

    def record_contacts(self, contacts: Sequence[tuple[Any, ...]], robot: PushedRobot) -> None:
        """Take note of contact points of a robot in the last physics step, as PyBullet lists them."""
        for contact in contacts:
            index, force_n = self._indices.get(contact[2]), contact[9]
            if index is None or not force_n > 0.0:
                continue
            # From the axis of the capsule to the point on its surface.
            (point_x, point_y, _), (axis_x, axis_y) = contact[6], self._positions[index]
            x, y = point_x - axis_x, point_y - axis_y
            length = math.hypot(x, y)
            if length > 0.0:
                if (push := self._pushes.get(index)) is None:
                    push = self._pushes[index] = _Push()
                push.add(force_n * x / length, force_n * y / length, robot.velocity_xy())

    @property
    def are_pushing(self) -> bool:
        """Whether contact points were recorded since the last `yield_to_robots`."""
        return bool(self._pushes)

    def yield_to_robots(self, share: float, timestep_s: float) -> None:
        """Set back the capsules that would push harder than they may in the next physics step.

        They are about to move by `share` of their way in this control step.
        """
        for index, push in self._pushes.items():
            old, new = self._old[index], self.poses[index]
            advance = [share * (new[axis] - old[axis]) for axis in (0, 1)]
            back_x, back_y = push.retreat_m(advance, self._limits_n[index], timestep_s)
            if back_x or back_y:
                x, y = self._offsets.get(index, (0.0, 0.0))
                self._offsets[index] = x - back_x, y - back_y
        self._pushes.clear()

    def end_step(self) -> None:
        """Update the poses of capsules that were held back."""
        for index, (back_x, back_y) in self._offsets.items():
            x, y, z, yaw = self.poses[index]
            self.poses[index] = [x + back_x, y + back_y, z, yaw]
        self.any_held_back = bool(self._offsets)

    def _move(self, index: int, pose: list[float]) -> None:
        x, y, z, yaw = pose
        pybullet.resetBasePositionAndOrientation(
            self.handles[index],
            (x, y, z + self._centre_heights[index]),
            _attitude(yaw),
            physicsClientId=self._client,
        )


def _attitude(yaw: float) -> tuple[float, float, float, float]:
    """Quaternion xyzw of a yaw [rad]."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)
