"""The base link of a robot in DART: its state, and external forces on it."""

import math
from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.library import dartpy

# No robot drives down a slope faster than this.
_FALL_MPS = 0.5


class FloatingBase:
    """The base link of the skeleton `robot`.

    Its state is read at most once between two calls of `mark_moved`.
    """

    def __init__(self, robot: Any) -> None:
        self._body, self._joint = robot.getBodyNode(0), robot.getJoint(0)
        self._state: tuple[list[float], list[float]] | None = None

    def place(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        """Put the link's origin at `position_w` (3) [m], turned by `quaternion` (4, xyzw)."""
        x, y, z, w = quaternion
        self._joint.setTransform(dartpy.math.Isometry3(dartpy.math.Quaternion(w, x, y, z), list(position_w)))
        self._state = None

    @property
    def mass_kg(self) -> float:
        """Mass of the link."""
        return float(self._body.getMass())

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._state = None

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the link's origin, and its speed [m/s] in all three directions."""
        (_, _, _, x, y, _), (_, _, _, vx, vy, vz) = self._read()
        return x, y, math.hypot(vx, vy, vz)

    def is_falling(self) -> bool:
        """Whether the link moves down faster than in any drive down a slope."""
        return self._read()[1][5] < -_FALL_MPS

    def state(self) -> tuple[float, ...]:
        """Pose and velocities (13), as in `PhysicsRobot.body_state`."""
        (rx, ry, rz, px, py, pz), (ax, ay, az, vx, vy, vz) = self._read()
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
        return (px, py, pz, scale * rx, scale * ry, scale * rz, math.cos(angle / 2), vx, vy, vz, ax, ay, az)

    def _read(self) -> tuple[list[float], list[float]]:
        """Positions and velocities (6 each) of the base joint."""
        state = self._state
        if state is None:
            # The joint's getters cost a tenth of the body's, which derives its state from the joint.
            joint = self._joint
            self._state = state = joint.getPositions().tolist(), joint.getVelocities().tolist()
        return state

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N], world frame, on the centre of mass in the next physics step."""
        # Set again in each step, because the engine keeps a force in the body's frame, which may turn.
        self._body.setExtForce(force_w, self._body.getLocalCOM(), False, True)

    def clear_force(self) -> None:
        """Remove the force of `act_force`."""
        self._body.clearExternalForces()
