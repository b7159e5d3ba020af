"""Couplings between joints of a robot in DART, as gears with motors at either joint or none."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import Coupling, RobotBody

# Share of the position error that is corrected in a physics step.
_ERROR_REDUCTION = 0.2


def has_driven_coupling(spec: RobotBody) -> bool:
    """Whether any coupled joint has a motor."""
    coupled = {name for each in spec.couplings for name in (each.leader, each.follower)}
    return not coupled.isdisjoint(spec.drive_joints)


class Gears:
    """Keeps the angles of followers at their ratios to the leaders'.

    After each physics step the skeleton `robot` gets the impulses that were
    missing to keep the ratios, and the corresponding torques act in the steps
    to come: under a constant load the missing impulses soon vanish. Servos
    accept no external torque: for joints with a motor it has to be added to
    the torque limits, which is equivalent.
    """

    def __init__(
        self, robot: Any, couplings: Sequence[Coupling], drive_joints: Sequence[str], timestep_s: float
    ) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint.getIndexInSkeleton(0) for joint in robot.getJoints()[1:]}
        # One row per coupling: the constraint's Jacobian over all joints.
        self._jacobian = np.zeros((len(couplings), robot.getNumDofs()))
        for row, coupling in zip(self._jacobian, couplings, strict=True):
            row[joints[coupling.follower]] = 1.0
            row[joints[coupling.leader]] = -coupling.ratio
        self._drives = [joints[name] for name in drive_joints]
        coupled = np.flatnonzero(self._jacobian.any(axis=0)).tolist()
        self._undriven = [index for index in coupled if index not in self._drives]
        self._torques = np.zeros(len(couplings))
        # Torques [N m] of the gears on the motors' joints in the next physics step.
        self.drive_torques: Array = np.zeros(len(self._drives))

    def after(self) -> None:
        """Correct the error of the ratios that the last physics step has left."""
        robot, jacobian = self._robot, self._jacobian
        speeds = robot.getVelocities()
        error = jacobian @ speeds + _ERROR_REDUCTION / self._step_s * (jacobian @ robot.getPositions())
        response = robot.getInvMassMatrix() @ jacobian.T
        impulses = np.linalg.solve(jacobian @ response, -error)
        robot.setVelocities(speeds + response @ impulses)
        self._torques += impulses / self._step_s
        torques = self._torques @ jacobian
        self.drive_torques = torques[self._drives]
        robot.setForces(self._undriven, torques[self._undriven])
