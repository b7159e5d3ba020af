"""Anisotropic friction of tyres in DART: less along the axle than along the tread."""

from collections.abc import Sequence
from typing import Any

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.physics.dart.joints import SLIP, TYRE


class LateralSlip:
    """Lateral slip of wheels as motion of joints with dry friction; DART's contacts are isotropic.

    A wheel's contact sticks, and the joint of `joints.add_slip_joint` slips at
    the friction limit of the tyre along its axle, which is proportional to the
    load in the step before. After each step the joint is set back to 0, as a
    tyre that has slipped has no restoring force.

    `feet` are the ground links' bodies in the skeleton `robot`; those without
    such a joint are not changed. `share` is the friction along the axle over
    that along the tread.
    """

    def __init__(self, robot: Any, feet: Sequence[Any], share: float, timestep_s: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint for joint in robot.getJoints()}
        names = [foot.getParentJoint().getName() for foot in feet]
        self._wheels = [number for number, name in enumerate(names) if name + SLIP in joints]
        slip_joints = [joints[names[number] + SLIP] for number in self._wheels]
        self._tyres = [joints[names[number] + TYRE].getIndexInSkeleton(0) for number in self._wheels]
        # Access through the joints would take ten times as long.
        self._dofs = [robot.getDof(joint.getIndexInSkeleton(0)) for joint in slip_joints]
        self._shares = [
            share * _lever_m(joint, feet[number])
            for joint, number in zip(slip_joints, self._wheels, strict=True)
        ]
        self._limits: Sequence[float] = ()
        self._usual_load_n = robot.getMass() * GRAVITY_MPS2 / len(feet)

    def set_friction(self, friction: Sequence[float]) -> None:
        """Set the friction coefficient of each foot along its tread, multiplied with the ground's."""
        self._limits = [
            share * friction[number] for share, number in zip(self._shares, self._wheels, strict=True)
        ]

    def after(self, impulses: Sequence[float]) -> None:
        """Set the joints' friction in the next physics step by the wheels' loads in the last one.

        `impulses` [N s, N m s] are the constraint impulses of all joints in that.
        """
        # First, because the engine has the forces on a wheel in the wheel's own frame.
        for dof in self._dofs:
            dof.setPosition(0.0)
        # Sum of the forces of joint constraints and of contacts; only the latter are the load.
        forces = self._robot.getConstraintForces().tolist()
        for dof, limit, tyre in zip(self._dofs, self._limits, self._tyres, strict=True):
            load = forces[tyre] - impulses[tyre] / self._step_s
            # In the air, the limit is that of the wheel's share of the weight.
            dof.setCoulombFriction(limit * (load if load > 0.0 else self._usual_load_n))


def _lever_m(joint: Any, foot: Any) -> float:
    """Factor from a force along the axle to the joint's force or torque: a sphere's radius, else 1."""
    if joint.getType() == "PrismaticJoint":
        return 1.0
    (radius,) = [node.getShape().getRadius() for node in foot.getShapeNodes() if node.hasCollisionAspect()]
    return float(radius)
