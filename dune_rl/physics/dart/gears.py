"""Gears between joints, in a DART scene."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import Coupling, RobotBody

Array = NDArray[np.float64]

# What the joints are off by falls by this share in a physics step.
_RETURN = 0.2


def drives_any(spec: RobotBody) -> bool:
    """Whether a motor is at a joint of any coupling."""
    coupled = {name for each in spec.couplings for name in (each.leader, each.follower)}
    return not coupled.isdisjoint(spec.drive_joints)


class Gears:
    """Keeps followers at their ratios to leaders, with motors at either joint or without.

    After each physics step the whole skeleton `robot` is given the impulses
    that it lacked to keep the ratios, and what torques they stand for acts in
    the steps to come: under a load that stays, soon nothing is lacking. Servos
    take no torque from elsewhere: it is to be added to the limits of theirs,
    which is the same.
    """

    def __init__(
        self, robot: Any, couplings: Sequence[Coupling], drive_joints: Sequence[str], timestep_s: float
    ) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint.getIndexInSkeleton(0) for joint in robot.getJoints()[1:]}
        # One row a coupling: what it keeps at 0, of all joints.
        self._kept = np.zeros((len(couplings), robot.getNumDofs()))
        for row, coupling in zip(self._kept, couplings, strict=True):
            row[joints[coupling.follower]] = 1.0
            row[joints[coupling.leader]] = -coupling.ratio
        self._drives = [joints[name] for name in drive_joints]
        coupled = np.flatnonzero(self._kept.any(axis=0)).tolist()
        self._undriven = [index for index in coupled if index not in self._drives]
        self._torques = np.zeros(len(couplings))
        # Torques [N m] of the gears on the motors' joints in the physics step to come.
        self.on_drives: Array = np.zeros(len(self._drives))

    def after(self) -> None:
        """Make up for what the physics step that was made has left of the ratios."""
        robot, kept = self._robot, self._kept
        speeds = robot.getVelocities()
        off = kept @ speeds + _RETURN / self._step_s * (kept @ robot.getPositions())
        answer = robot.getInvMassMatrix() @ kept.T
        impulses = np.linalg.solve(kept @ answer, -off)
        robot.setVelocities(speeds + answer @ impulses)
        self._torques += impulses / self._step_s
        torques = self._torques @ kept
        self.on_drives = torques[self._drives]
        robot.setForces(self._undriven, torques[self._undriven])
