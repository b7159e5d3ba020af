"""Kinematic bodies of a PyBullet scene."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.contact_gate import GatedRobot
from dune_rl.physics.interface import KINEMATIC_FRICTION, KinematicCapsule
from dune_rl.physics.stderr import suppress_stderr

with suppress_stderr():
    import pybullet

# A body that ends a control step farther than this from all robots, and than they reach, is not near.
_NEAR_M = 2.0
_MARGIN_M = 0.5

# Bodies that are not near any robot are moved out of the way once, and not at all after that.
_PARKED_Z_M = -1e4


class BulletCapsules:
    """The kinematic capsules of a PyBullet client, in collision `group` with `mask`."""

    def __init__(self, client: int, bodies: Sequence[KinematicCapsule], group: int, mask: int) -> None:
        self._client = client
        self.handles = [self._add(body, group, mask) for body in bodies]
        self._centre_heights = [body.height_m / 2 for body in bodies]
        self._radii = [body.radius_m for body in bodies]
        self._parked = [False] * len(bodies)
        self._poses = np.zeros((len(bodies), 4))

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
        for index, pose in enumerate(poses.tolist()):
            self._move(index, pose)
            self._parked[index] = False
        self._poses[:] = poses

    def begin_step(
        self, poses: NDArray[np.float64], robots: Sequence[GatedRobot]
    ) -> list[tuple[int, list[float], list[float]]]:
        """Start the motion to `poses` (K, 4); the bodies near robots, as index, present and final pose.

        These are to be moved by `move`; others cannot touch a robot before the next control step.
        """
        if not self.handles:
            return []
        near = []
        places = [(*robot.planar_motion()[:2], robot.reach_m) for robot in robots]
        for index, (old, new) in enumerate(zip(self._poses.tolist(), poses.tolist(), strict=True)):
            room = self._radii[index] + _MARGIN_M + abs(new[0] - old[0]) + abs(new[1] - old[1])
            for x, y, reach in places:
                limit = max(_NEAR_M, reach + room)
                if abs(new[0] - x) < limit and abs(new[1] - y) < limit:
                    near.append((index, old, new))
                    self._parked[index] = False
                    break
            else:
                if not self._parked[index]:
                    self._move(index, [0.0, 0.0, _PARKED_Z_M, 0.0])
                    self._parked[index] = True
        self._poses[:] = poses
        return near

    def move(self, index: int, old: list[float], new: list[float], share: float) -> None:
        """Put a body at `share` of the way from one pose to another."""
        x, y, z = (a + (b - a) * share for a, b in zip(old[:3], new[:3], strict=True))
        self._move(index, [x, y, z, new[3]])

    def _move(self, index: int, pose: list[float]) -> None:
        x, y, z, yaw = pose
        pybullet.resetBasePositionAndOrientation(
            self.handles[index],
            (x, y, z + self._centre_heights[index]),
            (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            physicsClientId=self._client,
        )
