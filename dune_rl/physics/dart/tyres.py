"""Compliant ground under a robot's wheels in DART."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.physics.dart.joints import TYRE
from dune_rl.physics.dart.library import dartpy

# Above these the load distribution over the wheels jumps: on ground of 1e7 N/m a rover is 7 % slower in
# curves.
_MAX_STIFFNESS_NPM, _MAX_DAMPING_NSPM = 2e5, 4e3


class CompliantGround:
    """Compliance of the ground under each wheel, as motion of the wheel's tyre joint.

    DART's contacts are rigid, and solved after the springs and dampers of
    joints: with a spring, a wheel that lands stops alone while the body above
    it moves on, and the lighter the wheel the softer the spring. So the tyre
    joints become servos, which are solved together with contacts: the robot
    lands as a whole, and rebounds by the restitution of its contacts, which
    the servos reduce by some 0.1. Before each physics step a servo's command
    is the speed of a spring and a damper under the wheel's load in the last
    step.

    `wheels` are the ground links' bodies in the skeleton `robot`; the contacts
    of those without a tyre joint stay rigid. `softness` is the constraint
    force mixing of servos, `JointConstraint.getConstraintForceMixing`.
    """

    def __init__(self, robot: Any, wheels: Sequence[Any], timestep_s: float, softness: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint for joint in robot.getJoints()}
        names = [f"{wheel.getParentJoint().getName()}{TYRE}" for wheel in wheels]
        self._sprung = [number for number, name in enumerate(names) if name in joints]
        tyre_joints = [joints[names[number]] for number in self._sprung]
        self._dofs = [joint.getIndexInSkeleton(0) for joint in tyre_joints]
        self._dof_array = np.array(self._dofs, int)
        mass = np.array([_sprung_mass_kg(wheels[number]) for number in self._sprung])
        above = (robot.getMass() - mass.sum()) / len(wheels)
        # Speed [m/s] at which a servo yields under an impulse of 1 N s.
        self._servo_compliance = softness * (1.0 / mass + 1.0 / above)
        self._load, self._commands = np.zeros((2, len(self._sprung)))
        for joint in tyre_joints:
            joint.setSpringStiffness(0, 0.0)
            joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)

    def set(self, stiffness: Sequence[float], damping: Sequence[float]) -> None:
        """Set the ground's `stiffness` [N/m] and `damping` [N s/m], one of each per wheel.

        They are limited to 2e5 N/m and 4e3 N s/m.
        """
        self._stiffness = np.minimum(stiffness, _MAX_STIFFNESS_NPM)[self._sprung]
        damper = np.minimum(damping, _MAX_DAMPING_NSPM)[self._sprung]
        # Implicit integration: the spring's force at the end of a step includes what the step adds.
        self._damping = damper + self._stiffness * self._step_s
        # If the ground is softer than the servos, the load of one step does not predict that of the next:
        # without a low-pass filter the two oscillate.
        lag = 2.0 * self._servo_compliance * self._damping * self._step_s
        self._filter_gain = lag / (1.0 + lag)

    def command_servos(self) -> None:
        """Set the speeds of the servos in the next physics step."""
        if not self._sprung:
            return
        robot, dofs = self._robot, self._dofs
        # Force of contacts and servo on a joint, minus that of its servo.
        load = robot.getConstraintForces() - robot.getJointConstraintImpulses() / self._step_s
        self._load += self._filter_gain * (load[self._dof_array] - self._load)
        speeds = (self._load - self._stiffness * robot.getPositions(dofs)) / self._damping
        # A servo yields under load by itself: the command is reduced by that.
        self._commands += speeds - robot.getVelocities(dofs)
        robot.setCommands(dofs, self._commands)


def _sprung_mass_kg(wheel: Any) -> float:
    """Mass of a wheel and of the links between it and its tyre joint."""
    mass = float(wheel.getMass())
    while not wheel.getParentJoint().getName().endswith(TYRE):
        wheel = wheel.getParentBodyNode()
        mass += wheel.getMass()
    return mass
