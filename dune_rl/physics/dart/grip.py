"""Tyres in DART that grip less along their axles than along their treads."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.joints import GRIP, TYRE

_GRAVITY_MPS2 = 9.81


class Grip:
    """Lets wheels slip along their axles at joints of dry friction: DART's contacts grip alike any way.

    A wheel's contact sticks, and the joint of `dart_joints.let_slip` gives way
    where the friction of a tyre along its axle would, which goes with the load
    of the step before. After each step the joint is where it was, as a tyre
    that has slipped keeps no memory of it.

    `feet` are the bodies of the skeleton `robot` that stand on the ground; those
    without such a joint are left as they are. `share` is what they grip along
    the axle of what they grip along the tread.
    """

    def __init__(self, robot: Any, feet: Sequence[Any], share: float, timestep_s: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint for joint in robot.getJoints()}
        names = [foot.getParentJoint().getName() for foot in feet]
        self._wheels = [number for number, name in enumerate(names) if name + GRIP in joints]
        grips = [joints[names[number] + GRIP] for number in self._wheels]
        self._tyres = [joints[names[number] + TYRE].getIndexInSkeleton(0) for number in self._wheels]
        # To ask the joints takes ten times as long.
        self._dofs = [robot.getDof(joint.getIndexInSkeleton(0)) for joint in grips]
        self._shares = [
            share * _lever_m(joint, feet[number]) for joint, number in zip(grips, self._wheels, strict=True)
        ]
        self._limits: Sequence[float] = ()
        self._usual_load_n = robot.getMass() * _GRAVITY_MPS2 / len(feet)

    def set_friction(self, friction: Sequence[float]) -> None:
        """Set the coefficient of each foot along its tread, its own times the ground's."""
        self._limits = [
            share * friction[number] for share, number in zip(self._shares, self._wheels, strict=True)
        ]

    def after(self, impulses: Sequence[float]) -> None:
        """Hold the wheels in the next physics step by what they bore in the last one.

        `impulses` [N s, N m s] are those of all joints' constraints in that.
        """
        # First: the engine has what bears on a wheel in the wheel's own frame.
        for dof in self._dofs:
            dof.setPosition(0.0)
        # Those of joints' constraints are in it, and those of contacts, which alone are the load.
        forces = self._robot.getConstraintForces().tolist()
        for dof, limit, tyre in zip(self._dofs, self._limits, self._tyres, strict=True):
            load = forces[tyre] - impulses[tyre] / self._step_s
            # In the air a wheel is held as it will be where it lands.
            dof.setCoulombFriction(limit * (load if load > 0.0 else self._usual_load_n))


def _lever_m(grip: Any, foot: Any) -> float:
    """What makes of a force along the axle what the joint feels: a ball's radius where it rolls, else 1."""
    if grip.getType() == "PrismaticJoint":
        return 1.0
    (radius,) = [node.getShape().getRadius() for node in foot.getShapeNodes() if node.hasCollisionAspect()]
    return float(radius)
