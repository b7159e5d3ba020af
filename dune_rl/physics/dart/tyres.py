"""How a robot's wheels stand on ground that yields, in a DART scene."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.physics.dart.joints import TYRE
from dune_rl.physics.dart.library import dartpy

# Stiffer wheels share a weight by fits and starts: on ground of 1e7 N/m a rover is 7 % slower in its curves.
_STIFFEST_NPM, _MOST_DAMPING_NSPM = 2e5, 4e3


class YieldingGround:
    """The give of the ground under each wheel, as motion of the sliding joint that the wheel hangs on.

    DART's contacts are rigid, and it takes them after the springs and dampers
    of joints: on a spring, a wheel that lands stops alone, the body above it
    goes on, and the spring is as soft as the wheel is light. So the sliding
    joints become servos, which are solved together with contacts: what lands
    lands as a whole, and bounces by the restitution of its contacts, of which
    the servos take some 0.1. Before each physics step a servo is told how fast a
    spring and a damper would yield under what bore on its wheel in the last
    one.

    `wheels` are the bodies of the skeleton `robot` that stand on the ground;
    the contacts of those that hang on no such joint stay rigid. `softness` is
    that of servos, `JointConstraint.getConstraintForceMixing`.
    """

    def __init__(self, robot: Any, wheels: Sequence[Any], timestep_s: float, softness: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint for joint in robot.getJoints()}
        names = [f"{wheel.getParentJoint().getName()}{TYRE}" for wheel in wheels]
        self._hung = [number for number, name in enumerate(names) if name in joints]
        hung_on = [joints[names[number]] for number in self._hung]
        self._dofs = [joint.getIndexInSkeleton(0) for joint in hung_on]
        self._of_dofs = np.array(self._dofs, int)
        mass = np.array([_hanging_kg(wheels[number]) for number in self._hung])
        above = (robot.getMass() - mass.sum()) / len(wheels)
        # The speed [m/s] by which a servo gives way to an impulse of 1 N s.
        self._give = softness * (1.0 / mass + 1.0 / above)
        self._load, self._told = np.zeros((2, len(self._hung)))
        for joint in hung_on:
            joint.setSpringStiffness(0, 0.0)
            joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)

    def set(self, stiffness: Sequence[float], damping: Sequence[float]) -> None:
        """Have the ground yield as springs of `stiffness` [N/m] and `damping` [N s/m], a number a wheel.

        It is never harder than 2e5 N/m with 4e3 N s/m.
        """
        self._stiffness = np.minimum(stiffness, _STIFFEST_NPM)[self._hung]
        damper = np.minimum(damping, _MOST_DAMPING_NSPM)[self._hung]
        # The spring at the end of a step is that at its start and what the step adds.
        self._damping = damper + self._stiffness * self._step_s
        # Where the ground gives way more easily than servos do, the load of one step is no measure of that
        # of the next: they would swing against each other.
        lag = 2.0 * self._give * self._damping * self._step_s
        self._trust = lag / (1.0 + lag)

    def lead(self) -> None:
        """Tell the servos how fast to yield in the physics step to come."""
        if not self._hung:
            return
        robot, dofs = self._robot, self._dofs
        # What contacts and servos do to a joint together, less what its servo does.
        load = robot.getConstraintForces() - robot.getJointConstraintImpulses() / self._step_s
        self._load += self._trust * (load[self._of_dofs] - self._load)
        yielding = (self._load - self._stiffness * robot.getPositions(dofs)) / self._damping
        # A servo gives way by itself to what it bears: that much less is told.
        self._told += yielding - robot.getVelocities(dofs)
        robot.setCommands(dofs, self._told)


def _hanging_kg(wheel: Any) -> float:
    """Mass of a wheel and of the links that it hangs on, up to the sliding joint."""
    mass = float(wheel.getMass())
    while not wheel.getParentJoint().getName().endswith(TYRE):
        wheel = wheel.getParentBodyNode()
        mass += wheel.getMass()
    return mass
