"""Kinematic bodies of a PyBullet scene."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import KINEMATIC_FRICTION, KinematicCapsule
from dune_rl.physics.stderr import suppress_stderr

with suppress_stderr():
    import pybullet

# Bodies that are not near any robot are moved out of the way once, and not at all after that.
_PARKING_POSE = [0.0, 0.0, -1e4, 0.0]


class BulletCapsules:
    """The kinematic capsules of a PyBullet client, in collision `group` with `mask`.

    `poses` (K, 4: x, y, z, yaw) are those at the end of the last control step.
    """

    def __init__(self, client: int, bodies: Sequence[KinematicCapsule], group: int, mask: int) -> None:
        self._client = client
        self.handles = [self._add(body, group, mask) for body in bodies]
        self._centre_heights = [body.height_m / 2 for body in bodies]
        self._parked = [False] * len(bodies)
        self.poses: list[list[float]] = [[0.0] * 4 for _ in bodies]
        self._old = self.poses

    def _add(self, body: KinematicCapsule, group: int, mask: int) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CAPSULE,
            radius=body.radius_m,
            height=body.height_m - 2 * body.radius_m,
            physicsClientId=self._client,
        )
        handle: int = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(handle, -1, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(handle, -1, lateralFriction=KINEMATIC_FRICTION, physicsClientId=self._client)
        return handle

    def reset(self, poses: NDArray[np.float64]) -> None:
        """Put the bodies at `poses` (K, 4)."""
        self.poses = poses.tolist()
        for index, pose in enumerate(self.poses):
            self._move(index, pose)
            self._parked[index] = False

    def begin_step(self, poses: list[list[float]], near: Sequence[int]) -> None:
        """Start the motion to `poses` (K, 4) of the bodies whose indices are in `near`; remove all others."""
        self._old, self.poses = self.poses, poses
        for index, is_parked in enumerate(self._parked):
            if index in near:
                self._parked[index] = False
            elif not is_parked:
                self._move(index, _PARKING_POSE)
                self._parked[index] = True

    def move(self, index: int, share: float) -> None:
        """Put a body at `share` of the way that it moves in this control step."""
        new = self.poses[index]
        x, y, z = (a + (b - a) * share for a, b in zip(self._old[index][:3], new[:3], strict=True))
        self._move(index, [x, y, z, new[3]])

    def _move(self, index: int, pose: list[float]) -> None:
        x, y, z, yaw = pose
        pybullet.resetBasePositionAndOrientation(
            self.handles[index],
            (x, y, z + self._centre_heights[index]),
            (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            physicsClientId=self._client,
        )
