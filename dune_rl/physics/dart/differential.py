"""Differentials in DART: a body held at the mean angle of two arms that turn opposite to each other."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.robot_body import Coupling

_TORQUE_NM = 1e4
# A larger error of the body's angle is corrected by setting the position.
_MAX_ERROR_RAD = 2.5e-4


class Differential:
    """Keeps the body of a skeleton at the mean angle of two arms; the second is a child of the first.

    See `joints.chain_differential`. DART couples joints in one direction: the
    follower reacts to the leader at once, and acts back on it a step later.
    That is stable only if the follower is light. Compared with arms that stand
    on the ground the body is: so the joint between the arms turns freely, and
    a servo turns the body by half of its angle. After an impact on an arm,
    which the servo cannot anticipate, the body lags by some milliradians; it
    is then rotated by that much after the step.
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
        """Command the body's servo to follow the arms in the next physics step.

        `impulses` [N m s] are the constraint impulses of all joints in the last one.
        """
        robot, both, step = self._robot, self._both, self._step_s
        body, between = robot.getPositions(both).tolist()
        error = body + between / 2
        if abs(error) > _MAX_ERROR_RAD:
            self._rotate_body(error)
            robot.setPosition(self.body, -between / 2)
            error = 0.0
        speed = -error / step - robot.getVelocity(self.between) / 2
        robot.setCommands(both, [speed, impulses[self.body] / step / 2])

    def _rotate_body(self, angle: float) -> None:
        """Rotate the body, without its arms, about their axis."""
        turn = dartpy.math.Isometry3(dartpy.math.AngleAxis(angle, self._axis).to_rotation_matrix(), [0.0] * 3)
        pose = self._base_joint.getRelativeTransform()
        pose = pose.multiply(self._hinge).multiply(turn).multiply(self._hinge.inverse())
        self._base_joint.setTransform(pose)


def is_chained(robot: Any, coupling: Coupling) -> bool:
    """Whether the follower is a child of the leader's link in the skeleton `robot`."""
    parent = robot.getJoint(coupling.follower).getParentBodyNode()
    return bool(parent.getParentJoint().getName() == coupling.leader)


def configure_differential(robot: Any, coupling: Coupling) -> None:
    """Give the joint between the arms the friction, damping and limits of both arms, and the body a servo."""
    body, between = robot.getJoint(coupling.leader), robot.getJoint(coupling.follower)
    # The angle between the arms is twice that of either: a torque there does twice the work, damping
    # four times.
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
