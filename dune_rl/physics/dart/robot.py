"""A robot in a DART scene."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart.differential import Differential, configure_differential, is_chained
from dune_rl.physics.dart.files import robot_urdf
from dune_rl.physics.dart.gears import Gears, has_driven_coupling
from dune_rl.physics.dart.grip import LateralSlip
from dune_rl.physics.dart.joints import SLIP, TYRE
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.massless import weld_massless_body
from dune_rl.physics.dart.tyres import CompliantGround
from dune_rl.physics.interface import RobotBody, Tyre
from dune_rl.physics.motors import Servos, held_targets, motor_power_w
from dune_rl.physics.varied_body import BodyVariation, scale_motors, varied_urdf

# DART uses the smaller friction coefficient of the two shapes of a contact. The robot's is always larger,
# so that the other shape's, which is the product of both bodies', is used.
ROBOT_FRICTION = 1e3

# The loads of four rigid wheels on rigid ground are not unique, and neither are the torques of servos on one
# body: a direct solver then puts a rover's weight on two of its wheels, and its yaw rate jumps. Tyres that
# yield by less than a millimetre and servos that yield by 0.5 % of a rover's speed make both unique. The
# servos' softness applies to every scene in the process.
_TYRE_STIFFNESS_NPM = 1e5
_SOFTNESS = 0.07
dartpy.constraint.JointConstraint.setConstraintForceMixing(_SOFTNESS)

# More than any joint that stands for compliance or slip of a tyre moves in a physics step.
_MAX_DEFLECTION_M = 0.05

# The compliance of a wheel's contact has the ending TYRE, on its joint.
_TYRE_ENDING = "/tyre shape"
# With so many, the radius of a rover's tyre varies by 0.4 mm.
_TYRE_SPHERES = 32

# No robot drives down a slope faster than this.
_FALL_MPS = 0.5


class DartRobot:
    """A `PhysicsRobot` without its contacts: a skeleton that `load` creates anew.

    `terrain_friction` is the ground's coefficient, which holds until `set_foot_contacts` is called.
    """

    skeleton: Any

    def __init__(
        self, spec: RobotBody, timestep_s: float, *, measures_work: bool, terrain_friction: float = 1.0
    ) -> None:
        self.spec, self._timestep_s = spec, timestep_s
        self._foot_friction = [spec.ground_friction * terrain_friction] * len(spec.ground_links)
        self._template = _load_template(spec)
        self.skeleton = None
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._motors = spec.motors
        # Ideal motors take a command once a control step; others need the joint states in every physics step.
        self._has_ideal_motors = all(motor.is_ideal for motor in self._motors) and not has_driven_coupling(
            spec
        )
        self._has_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in self._motors)
        self._servos = Servos(self._motors, timestep_s)
        self._commands: Sequence[float] = spec.rest_commands()
        self._force: Sequence[float] | None = None
        self._measures_work = measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()
        self._gears: Gears | None = None
        self._differentials: list[Differential] = []
        self._slip: LateralSlip | None = None
        self._base_state: tuple[list[float], list[float]] | None = None
        self.reach_m = self._measure_reach_m()

    @property
    def has_spherical_feet(self) -> bool:
        """Whether all collision shapes of ground links are spheres."""
        return self._has_only_spheres(feet=True)

    @property
    def has_spherical_hull(self) -> bool:
        """Whether all other collision shapes are spheres."""
        return self._has_only_spheres(feet=False)

    def _has_only_spheres(self, *, feet: bool) -> bool:
        ground_links = self.spec.ground_links
        bodies = [body for body in self._template.getBodyNodes() if (body.getName() in ground_links) == feet]
        nodes = [node for body in bodies for node in body.getShapeNodes() if node.hasCollisionAspect()]
        return all(isinstance(node.getShape(), dartpy.dynamics.SphereShape) for node in nodes)

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = scale_motors(self.spec.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._timestep_s)
        text = None if variation.keeps_masses else varied_urdf(self.spec.urdf, variation)
        self._template = _load_template(replace(self.spec, motors=self._motors), text)

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._pose = (position_w, quaternion)

    def load(self) -> Any:
        """Create the skeleton at the start pose, at rest and without tyres, and return it."""
        self.skeleton = robot = self._template.clone()
        self._base, self._base_joint = robot.getBodyNode(0), robot.getJoint(0)
        self._base_state = None
        self._tyres: frozenset[int] = frozenset()
        position, (x, y, z, w) = self._pose
        self._base_joint.setTransform(
            dartpy.math.Isometry3(dartpy.math.Quaternion(w, x, y, z), list(position))
        )
        self._drives = [self._dof_index(joint) for joint in self.spec.drive_joints]
        self._feet = [robot.getBodyNode(name) for name in self.spec.ground_links]
        self._ground: CompliantGround | None = None
        self._differentials = [
            Differential(robot, coupling, self._timestep_s)
            for coupling in self.spec.couplings
            if is_chained(robot, coupling)
        ]
        if self.spec.sideways_friction_share != 1.0:
            self._slip = LateralSlip(robot, self._feet, self.spec.sideways_friction_share, self._timestep_s)
            self._slip.set_friction(self._foot_friction)
        self._servo_compliances = self._compute_servo_compliances() if self._compensates_load else []
        self._impulses = [0.0] * robot.getNumDofs()
        self._gears = self._make_gears()
        self._gear_torques: Sequence[float] = (0.0,) * len(self._motors)
        self._commands = self.spec.rest_commands()
        self._servos.reset()
        self._force = None
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        return robot

    @property
    def tyre_names(self) -> list[str]:
        """Names of the bodies of all tyres, whether they are there or not."""
        return [f"{tyre.link}{_TYRE_ENDING}" for tyre in self.spec.tyres]

    def set_tyres(self, active: frozenset[int]) -> None:
        """Have the tyres with these indices, and no others, as bodies that are welded to the wheels.

        Python must not refer to the shapes of those that are removed.
        """
        names = self.tyre_names
        for index in sorted(self._tyres - active):
            self.skeleton.getBodyNode(names[index]).remove()
        for index in sorted(active - self._tyres):
            self._add_tyre(self.spec.tyres[index], names[index])
        self._tyres = active

    def _add_tyre(self, tyre: Tyre, name: str) -> None:
        body = weld_massless_body(self.skeleton.getBodyNode(tyre.link))
        body.setName(name)
        node = body.createShapeNode(_tyre_shape(tyre))
        turn, _ = Rotation.align_vectors([tyre.axis], [[0.0, 0.0, 1.0]])
        node.setRelativeTransform(dartpy.math.Isometry3(turn.as_matrix(), tyre.centre))
        node.createCollisionAspect()
        node.createDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)

    def _make_gears(self) -> Gears | None:
        couplings = [each for each in self.spec.couplings if not is_chained(self.skeleton, each)]
        if not couplings:
            return None
        return Gears(self.skeleton, couplings, self.spec.drive_joints, self._timestep_s)

    @property
    def _compensates_load(self) -> bool:
        """Whether commands compensate for the softness of servos, which matters if rotors outweigh wheels."""
        return not self._has_ideal_motors and all(
            motor.mode == "velocity" and motor.rotor_inertia_kgm2 > 0.0 for motor in self._motors
        )

    def _compute_servo_compliances(self) -> list[float]:
        """Speed [rad/s] at which each motor's servo yields under an impulse of 1 N m s."""
        inverse_inertias = self.skeleton.getInvMassMatrix().diagonal()[self._drives]
        compliances: list[float] = (_SOFTNESS * inverse_inertias).tolist()
        return compliances

    def release(self) -> None:
        """Drop the references to the engine's objects."""
        self.skeleton = self._base = self._base_joint = None

    def _dof_index(self, joint: str) -> int:
        index: int = self.skeleton.getJoint(joint).getIndexInSkeleton(0)
        return index

    def set_command(self, commands: Sequence[float]) -> None:
        self._commands = commands

    def _measure_reach_m(self) -> float:
        """Upper bound of the distance of any point of the robot from the base link's origin.

        Each link adds the distance of its joint from its parent's, whatever the angles of the joints are.
        """
        reach, distances = 0.0, dict[str, float]()
        for body in self._template.getBodyNodes():
            joint, parent = body.getParentJoint(), body.getParentBodyNode()
            distance = 0.0
            if parent is not None:
                step = body.getTransform(parent).translation()
                distance = distances[parent.getName()] + float(np.linalg.norm(step))
                if joint.getName().endswith((TYRE, SLIP)):
                    distance += _MAX_DEFLECTION_M
                elif joint.getType() == "PrismaticJoint":
                    low, high = joint.getPositionLowerLimit(0), joint.getPositionUpperLimit(0)
                    distance += max(abs(low), abs(high))
            distances[body.getName()] = distance
            for node in body.getShapeNodes():
                if node.hasCollisionAspect():
                    box, pose = node.getShape().getBoundingBox(), node.getRelativeTransform()
                    middle = pose.multiply(0.5 * (box.getMin() + box.getMax()))
                    half = 0.5 * np.linalg.norm(box.getMax() - box.getMin())
                    reach = max(reach, distance + float(np.linalg.norm(middle) + half))
        return max([reach, *(distances[tyre.link] + tyre.reach_m for tyre in self.spec.tyres)])

    @property
    def base_mass_kg(self) -> float:
        """Mass of the base link."""
        return float(self._base.getMass())

    def planar_motion(self) -> tuple[float, float, float]:
        """See `GatedRobot`; the position is that of the base link's origin."""
        (_, _, _, x, y, _), (_, _, _, vx, vy, vz) = self._read_base()
        return x, y, math.hypot(vx, vy, vz)

    def is_falling(self) -> bool:
        """Whether the base moves down faster than in any drive down a slope."""
        return self._read_base()[1][5] < -_FALL_MPS

    def begin_step(self, count: int) -> None:
        """Pass the commands to the motors for the next `count` physics steps."""
        if self._has_ideal_motors:
            robot, drives, commands = self.skeleton, self._drives, self._commands
            if self._has_curves:
                speeds = robot.getVelocities(drives).tolist()
                commands, torques = held_targets(self._motors, commands, speeds)
                robot.setForceUpperLimits(drives, torques)
                robot.setForceLowerLimits(drives, [-torque for torque in torques])
            robot.setCommands(drives, commands)
        else:
            self._servos.set_commands(self._commands, count)

    @property
    def acts_before_steps(self) -> bool:
        """Whether `before_physics_step` does anything."""
        return self._ground is not None or not self._has_ideal_motors

    def before_physics_step(self) -> None:
        """Set the commands of ground and motors for the next physics step."""
        if self._ground is not None:
            self._ground.command_servos()
        if not self._has_ideal_motors:
            self._command_motors()

    def _command_motors(self) -> None:
        """Set target speeds and torque limits of the motors."""
        robot, drives = self.skeleton, self._drives
        angles, speeds = robot.getPositions(drives).tolist(), robot.getVelocities(drives).tolist()
        targets, torques = self._servos.targets(angles, speeds)
        if self._servo_compliances:
            # Compensates for the mean load, as on a slope. Compensation for each motor's own load would make
            # the motors work against each other.
            impulses = self._impulses
            mean = sum([impulses[index] for index in drives]) / len(drives)
            targets = [
                target + compliance * mean
                for target, compliance in zip(targets, self._servo_compliances, strict=True)
            ]
        robot.setCommands(drives, targets)
        if self._gears is None:
            robot.setForceUpperLimits(drives, torques)
            robot.setForceLowerLimits(drives, [-torque for torque in torques])
            return
        self._gear_torques = gear_torques = self._gears.drive_torques.tolist()
        upper = [gear + torque for gear, torque in zip(gear_torques, torques, strict=True)]
        lower = [gear - torque for gear, torque in zip(gear_torques, torques, strict=True)]
        robot.setForceUpperLimits(drives, upper)
        robot.setForceLowerLimits(drives, lower)

    @property
    def acts_after_steps(self) -> bool:
        """Whether `after_physics_step` does anything."""
        slips = self.spec.sideways_friction_share != 1.0
        return slips or self._compensates_load or bool(self.spec.couplings) or self._measures_work

    def after_physics_step(self) -> None:
        """Update couplings, slip and work after a physics step."""
        if self._gears is not None:
            self._gears.after()
        if self._servo_compliances or self._differentials or self._slip is not None:
            self._impulses = impulses = self.skeleton.getJointConstraintImpulses().tolist()
            for differential in self._differentials:
                differential.after(impulses)
            if self._slip is not None:
                self._slip.after(impulses)
        if self._measures_work:
            self._add_work()

    def _add_work(self) -> None:
        speeds = self.skeleton.getVelocities(self._drives).tolist()
        # The joint speed changes linearly over a step under a constant torque.
        means = [(before + after) / 2 for before, after in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += motor_power_w(self._motors, means, self._torques()) * self._timestep_s

    def work_j(self) -> float:
        work, self._work = self._work, 0.0
        return work

    def apply_force(self, force_w: Sequence[float]) -> None:
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force set by `apply_force` since the last call, which is removed; None if there is none."""
        force, self._force = self._force, None
        return force

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N] in the next physics step."""
        # Set again in each step, because the engine keeps a force in the body's frame, which may turn.
        self._base.setExtForce(force_w, self._base.getLocalCOM(), False, True)

    def clear_force(self) -> None:
        """Remove the force of `act_force`."""
        self._base.clearExternalForces()

    def set_foot_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the contact parameters of each ground link; see `PhysicsRobot.set_wheel_contacts`."""
        for foot, foot_friction, foot_restitution in zip(self._feet, friction, restitution, strict=True):
            for node in foot.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(foot_friction)
                    node.getDynamicsAspect().setRestitutionCoeff(foot_restitution)
        if self._slip is not None:
            self._slip.set_friction(friction)
        if stiffness is None or damping is None:
            return
        if self._ground is None:
            self._ground = CompliantGround(self.skeleton, self._feet, self._timestep_s, _SOFTNESS)
        self._ground.set(stiffness, damping)

    def _torques(self) -> list[float]:
        impulses: list[float] = self.skeleton.getJointConstraintImpulses()[self._drives].tolist()
        # Python floats, which overflow without a warning if the state diverges.
        step_s = self._timestep_s
        return [
            impulse / step_s - gear_torque
            for impulse, gear_torque in zip(impulses, self._gear_torques, strict=True)
        ]

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._base_state = None

    def _read_base(self) -> tuple[list[float], list[float]]:
        """Positions and velocities (6 each) of the base joint, read once between physics steps."""
        state = self._base_state
        if state is None:
            # The joint's getters cost a tenth of the body's, which derives its state from the joint.
            joint = self._base_joint
            self._base_state = state = joint.getPositions().tolist(), joint.getVelocities().tolist()
        return state

    def body_state(self) -> tuple[float, ...]:
        (rx, ry, rz, px, py, pz), (ax, ay, az, vx, vy, vz) = self._read_base()
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
        return (px, py, pz, scale * rx, scale * ry, scale * rz, math.cos(angle / 2), vx, vy, vz, ax, ay, az)

    def drive_state(self) -> tuple[float, ...]:
        robot, drives = self.skeleton, self._drives
        return (
            *robot.getPositions(drives).tolist(),
            *robot.getVelocities(drives).tolist(),
            *self._torques(),
        )

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        if self.skeleton is None:
            return (0.0,) * len(joints)
        positions = self.skeleton.getPositions().tolist()
        # The second arm of a differential is a child of the first.
        for differential in self._differentials:
            positions[differential.between] += positions[differential.body]
        return tuple(positions[self._dof_index(joint)] for joint in joints)


def _tyre_shape(tyre: Tyre) -> Any:
    """Collision shape of a tyre about z: the convex hull of a ring of spheres.

    A cylinder has a line of possible contacts with a plane; the detector returns another point of it in each
    step, so that the wheel sinks by a centimetre and loses a tenth of its speed.
    """
    edge = min(tyre.width_m / 2, tyre.radius_m)
    angles = np.arange(_TYRE_SPHERES) * 2 * np.pi / _TYRE_SPHERES
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    centres = (tyre.radius_m - edge) * circle
    return dartpy.dynamics.MultiSphereConvexHullShape([(edge, centre) for centre in centres])


def _load_template(spec: RobotBody, text: str | None = None) -> Any:
    robot = parse_skeleton(robot_urdf(spec, text), spec.urdf.parent)
    if robot is None:
        raise PhysicsError(f"DART cannot load {spec.urdf}")
    for body in robot.getBodyNodes():
        for node in body.getShapeNodes():
            if node.hasDynamicsAspect():
                node.getDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)
    joints = {joint.getName(): joint for joint in robot.getJoints()[1:]}
    for name, joint in joints.items():
        if joint.getNumDofs() == 1:
            joint.setDampingCoefficient(0, 0.0)
            joint.setCoulombFriction(0, 0.0)
            joint.setLimitEnforcement(True)
            # The motor model limits the speed.
            joint.setVelocityLowerLimit(0, -math.inf)
            joint.setVelocityUpperLimit(0, math.inf)
            if name.endswith(TYRE):
                joint.setSpringStiffness(0, _TYRE_STIFFNESS_NPM)
    for passive in spec.passive:
        joints[passive.joint].setDampingCoefficient(0, passive.damping_nms_per_rad)
        joints[passive.joint].setCoulombFriction(0, passive.friction_nm)
    for motor in spec.motors:
        joint = joints[motor.joint]
        joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
        joint.setForceLowerLimit(0, -motor.max_torque_nm)
        joint.setForceUpperLimit(0, motor.max_torque_nm)
        joint.setPosition(0, motor.rest_rad)
    for coupling in spec.couplings:
        if is_chained(robot, coupling):
            configure_differential(robot, coupling)
    return robot


def parse_skeleton(urdf: str, folder: Path) -> Any:
    """Skeleton of the text of a URDF, whose paths are relative to `folder`; None if DART cannot parse it."""
    # DART does not decode percent signs in a path.
    return dartpy.utils.DartLoader().parseSkeletonString(urdf, f"file://{folder.resolve()}/")
