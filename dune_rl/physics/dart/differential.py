"""Differentials in DART: a body carried at the mean of two arms, which turn opposite to each other."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.interface import Coupling

_TORQUE_NM = 1e4
# Farther off than this, the body is put where it belongs.
_OFF_RAD = 2.5e-4


class Differential:
    """Carries the body of a skeleton at the mean of its arms, of which the second hangs on the first.

    See `dart_joints.chain`. DART couples joints one way: what follows feels what
    leads at once, and acts back on it a step later. That is stable only where
    what follows is light, as the body is beside arms that stand on the ground:
    the joint between the arms turns freely, and a servo turns the body by half
    of that. A blow to an arm, which no servo foresees, leaves the body behind
    by some milliradians, and after the step it is turned by so much.
    """

    def __init__(self, robot: Any, coupling: Coupling, timestep_s: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joint = robot.getJoint(coupling.leader)
        self._base_joint = robot.getJoint(0)
        self.body = joint.getIndexInSkeleton(0)
        self.between = robot.getJoint(coupling.follower).getIndexInSkeleton(0)
        self._both = [self.body, self.between]
        self._hinge = joint.getTransformFromParentBodyNode()
        self._axis = joint.getAxis()

    def after(self, impulses: Sequence[float]) -> None:
        """Lead the body in the next physics step to where its arms will be.

        `impulses` [N m s] are those of all joints' constraints in the last one.
        """
        robot, both, step = self._robot, self._both, self._step_s
        body, between = robot.getPositions(both).tolist()
        off = body + between / 2
        if abs(off) > _OFF_RAD:
            self._turn(off)
            robot.setPosition(self.body, -between / 2)
            off = 0.0
        speed = -off / step - robot.getVelocity(self.between) / 2
        robot.setCommands(both, [speed, impulses[self.body] / step / 2])

    def _turn(self, angle: float) -> None:
        """Turn the body, and not its arms, about their axis."""
        turn = dartpy.math.Isometry3(dartpy.math.AngleAxis(angle, self._axis).to_rotation_matrix(), [0.0] * 3)
        there = self._base_joint.getRelativeTransform()
        there = there.multiply(self._hinge).multiply(turn).multiply(self._hinge.inverse())
        self._base_joint.setTransform(there)


def is_chained(robot: Any, coupling: Coupling) -> bool:
    """Whether the follower hangs on the leader in the skeleton `robot`."""
    mount = robot.getJoint(coupling.follower).getParentBodyNode()
    return bool(mount.getParentJoint().getName() == coupling.leader)


def set_up(robot: Any, coupling: Coupling) -> None:
    """Have the joint between the arms turn with the friction, the damping and the limits of both arms."""
    body, between = robot.getJoint(coupling.leader), robot.getJoint(coupling.follower)
    # Between the arms is twice the angle of either: a torque there does twice the work, damping four times.
    between.setCoulombFriction(0, (body.getCoulombFriction(0) + between.getCoulombFriction(0)) / 2)
    damping = body.getDampingCoefficient(0) + between.getDampingCoefficient(0)
    between.setDampingCoefficient(0, damping / 4)
    low = max(between.getPositionLowerLimit(0), -body.getPositionUpperLimit(0))
    high = min(between.getPositionUpperLimit(0), -body.getPositionLowerLimit(0))
    between.setPositionLowerLimit(0, 2 * low)
    between.setPositionUpperLimit(0, 2 * high)
    body.setCoulombFriction(0, 0.0)
    body.setDampingCoefficient(0, 0.0)
    body.setLimitEnforcement(False)
    body.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
    body.setForceLowerLimit(0, -_TORQUE_NM)
    body.setForceUpperLimit(0, _TORQUE_NM)
