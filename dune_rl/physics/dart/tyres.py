"""Tyres and feet of a robot in DART: collision shapes, compliance, lateral slip and friction."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.loading import ROBOT_FRICTION, SLIP, TYRE, add_shape, weld_massless_body
from dune_rl.physics.dart.motors import SERVO_SOFTNESS
from dune_rl.physics.robot_body import RobotBody, Tyre

# The compliance of a wheel's contact has the ending `TYRE`, on its joint.
_ENDING = "/tyre shape"
# With so many, the radius of a rover's tyre varies by 0.4 mm.
_SPHERES = 32


def tyre_name(tyre: Tyre) -> str:
    """Name of a tyre's body, whether it is there or not."""
    return f"{tyre.link}{_ENDING}"


class TyreBodies:
    """The tyres of the skeleton `robot`, which has none at first."""

    def __init__(self, robot: Any, tyres: Sequence[Tyre]) -> None:
        self._robot, self._tyres = robot, tyres
        self._active: frozenset[int] = frozenset()

    def set_active(self, active: frozenset[int]) -> None:
        """Have the tyres with these indices, and no others, as bodies that are welded to the wheels.

        Python must not refer to the shapes of those that are removed.
        """
        for index in sorted(self._active - active):
            self._robot.getBodyNode(tyre_name(self._tyres[index])).remove()
        for index in sorted(active - self._active):
            self._add(self._tyres[index])
        self._active = active

    def _add(self, tyre: Tyre) -> None:
        body = weld_massless_body(self._robot.getBodyNode(tyre.link))
        body.setName(tyre_name(tyre))
        turn, _ = Rotation.align_vectors([tyre.axis], [[0.0, 0.0, 1.0]])
        pose = dartpy.math.Isometry3(turn.as_matrix(), tyre.centre)
        add_shape(body, _shape(tyre), ROBOT_FRICTION).setRelativeTransform(pose)


def _shape(tyre: Tyre) -> Any:
    """Collision shape of a tyre about z: the convex hull of a ring of spheres.

    A cylinder has a line of possible contacts with a plane; the detector returns another point of it in each
    step, so that the wheel sinks by a centimetre and loses a tenth of its speed.
    """
    edge = min(tyre.width_m / 2, tyre.radius_m)
    angles = np.arange(_SPHERES) * 2 * np.pi / _SPHERES
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    centres = (tyre.radius_m - edge) * circle
    return dartpy.dynamics.MultiSphereConvexHullShape([(edge, centre) for centre in centres])


# Above these the load distribution over the wheels jumps: on ground of 1e7 N/m a rover is 7 % slower in
# curves.
_MAX_STIFFNESS_NPM, _MAX_DAMPING_NSPM = 2e5, 4e3


class CompliantGround:
    """Compliance of the ground under each wheel, as motion of the wheel's tyre joint.

    DART's contacts are rigid, and solved after the springs and dampers of joints: with a spring, a wheel that
    lands stops alone while the body above it moves on, and the lighter the wheel the softer the spring. So
    the tyre joints become servos, which are solved together with contacts: the robot lands as a whole, and
    rebounds by the restitution of its contacts, which the servos reduce by some 0.1. Before each physics step
    a servo's command is the speed of a spring and a damper under the wheel's load in the last step.

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


class LateralSlip:
    """Lateral slip of wheels as motion of joints with dry friction; DART's contacts are isotropic.

    A wheel's contact sticks, and the joint of `loading.add_slip_joint` slips at the tyre's limit of friction
    along its axle, which is proportional to the load in the step before. After each step the joint is set
    back to 0, as a tyre that has slipped has no restoring force.

    `feet` are the ground links' bodies in the skeleton `robot`; those without such a joint are not changed.
    `share` is the friction along the axle over that along the tread.
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


class FootContacts:
    """Contact parameters of the W ground links of the skeleton `robot`, which `spec` describes.

    `friction` is the coefficient of all of them, multiplied with the ground's, until `set` is called.
    `slip` is None if tyres grip equally in all directions, `ground` if contacts are rigid.
    """

    def __init__(self, robot: Any, spec: RobotBody, friction: float, timestep_s: float) -> None:
        self._robot, self._timestep_s = robot, timestep_s
        self._feet = [robot.getBodyNode(name) for name in spec.ground_links]
        self.ground: CompliantGround | None = None
        self.slip: LateralSlip | None = None
        if spec.sideways_friction_share != 1.0:
            self.slip = LateralSlip(robot, self._feet, spec.sideways_friction_share, timestep_s)
            self.slip.set_friction([friction] * len(self._feet))

    def set(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the parameters (W each) as `PhysicsRobot.set_wheel_contacts`; both friction coefficients
        of a contact are multiplied in `friction`.
        """
        for foot, foot_friction, foot_restitution in zip(self._feet, friction, restitution, strict=True):
            for node in foot.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(foot_friction)
                    node.getDynamicsAspect().setRestitutionCoeff(foot_restitution)
        if self.slip is not None:
            self.slip.set_friction(friction)
        if stiffness is None or damping is None:
            return
        if self.ground is None:
            self.ground = CompliantGround(self._robot, self._feet, self._timestep_s, SERVO_SOFTNESS)
        self.ground.set(stiffness, damping)
