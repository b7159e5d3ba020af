"""Tyres in DART that grip less along their axles than along their treads."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart_joints import GRIP, TYRE


class Grip:
    """Lets wheels slip along their axles, at joints of dry friction: DART's contacts grip alike any way.

    The contact sticks, and the joint gives way where the friction of the tyre
    along its axle would, which goes with the load of the step before.
    """

    def __init__(self, robot: Any, wheel_joints: Sequence[str], share: float) -> None:
        self._robot = robot
        joints = [robot.getJoint(name + GRIP) for name in wheel_joints]
        self._slips = [joint.getIndexInSkeleton(0) for joint in joints]
        self._dofs = [robot.getDof(index) for index in self._slips]
        self._tyres = [robot.getJoint(name + TYRE).getIndexInSkeleton(0) for name in wheel_joints]
        self._shares = [share * _lever_m(robot.getJoint(name)) for name in wheel_joints]
        self._nowhere = [0.0] * len(joints)
        self._limits: Sequence[float] = ()

    def set_friction(self, friction: Sequence[float]) -> None:
        """Set the coefficient of each wheel along its tread."""
        self._limits = [share * each for share, each in zip(self._shares, friction, strict=True)]

    def after(self) -> None:
        """Take the loads of the physics step that was made for the next, and the wheels back to their places."""
        loads = self._robot.getConstraintForces()[self._tyres].tolist()
        for dof, limit, load in zip(self._dofs, self._limits, loads, strict=True):
            dof.setCoulombFriction(max(0.0, limit * load))
        self._robot.setPositions(self._slips, self._nowhere)


def _lever_m(wheel_joint: Any) -> float:
    """What turns what rubs along the axle into what the joint feels: a ball's radius, where it rolls."""
    wheel = wheel_joint.getChildBodyNode()
    if wheel.getParentBodyNode().getParentJoint().getType() == "PrismaticJoint":
        return 1.0
    radii = [node.getShape().getRadius() for node in wheel.getShapeNodes() if node.hasCollisionAspect()]
    return float(radii[0])
