"""A robot in a DART scene."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart.differential import Differential, is_chained, set_up
from dune_rl.physics.dart.files import robot_urdf
from dune_rl.physics.dart.gears import Gears, drives_any
from dune_rl.physics.dart.grip import Grip
from dune_rl.physics.dart.joints import TYRE
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.tyres import YieldingGround
from dune_rl.physics.interface import RobotBody
from dune_rl.physics.motors import Servos, work_w
from dune_rl.physics.varied_body import BodyVariation, motors_at, varied_urdf

# DART takes the lesser coefficient of two bodies that touch. The robot's is always the greater, so
# that the other body's, which is the product of both, counts.
NEVER_THE_LESSER = 1e3

# Four rigid wheels on rigid ground can share a weight in many ways, and servos on one body push against
# each other by any torque at all: a direct solver then has a rover stand on two of its wheels, and turn
# by fits and starts. Tyres that give by less than a millimetre and servos that give way by 0.5 % of a
# rover's speed settle both. The servos' softness is that of every scene in the process.
_TYRE_STIFFNESS_NPM = 1e5
_SOFTNESS = 0.07
dartpy.constraint.JointConstraint.setConstraintForceMixing(_SOFTNESS)

_FALL_MPS = 0.5


class DartRobot:
    """A `PhysicsRobot` but for what it touches: a skeleton, made anew by `place`.

    `terrain_friction` is the ground's, until `set_foot_contacts` says another.
    """

    skeleton: Any

    def __init__(
        self, spec: RobotBody, timestep_s: float, *, measures_work: bool, terrain_friction: float = 1.0
    ) -> None:
        self.spec, self._timestep_s = spec, timestep_s
        self._foot_friction = [spec.ground_friction * terrain_friction] * len(spec.ground_links)
        self._as_read = _read_robot(spec)
        self.skeleton = None
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._motors = spec.motors
        # Most wheels take a command as it is, once a control step; others need a look in every physics step.
        self._plain = all(motor.is_plain for motor in self._motors) and not drives_any(spec)
        self._servos = Servos(self._motors, timestep_s)
        self._commands: Sequence[float] = spec.rest_commands()
        self._push: Sequence[float] | None = None
        self._measures_work = measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()
        self._gears: Gears | None = None
        self._differentials: list[Differential] = []
        self._grip: Grip | None = None

    @property
    def feet_are_balls(self) -> bool:
        """Whether all that it stands on is spheres."""
        return self._are_balls(feet=True)

    @property
    def hull_is_balls(self) -> bool:
        """Whether all the rest of it is spheres."""
        return self._are_balls(feet=False)

    def _are_balls(self, *, feet: bool) -> bool:
        ground_links = self.spec.ground_links
        bodies = [body for body in self._as_read.getBodyNodes() if (body.getName() in ground_links) == feet]
        nodes = [node for body in bodies for node in body.getShapeNodes() if node.hasCollisionAspect()]
        return all(isinstance(node.getShape(), dartpy.dynamics.SphereShape) for node in nodes)

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = motors_at(self.spec.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._timestep_s)
        text = None if variation.is_of_the_urdf else varied_urdf(self.spec.urdf, variation)
        self._as_read = _read_robot(replace(self.spec, motors=self._motors), text)

    def stand(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._pose = (position_w, quaternion)

    def place(self) -> Any:
        """A skeleton of it where it is to stand, at rest."""
        self.skeleton = robot = self._as_read.clone()
        self._base, self._base_joint = robot.getBodyNode(0), robot.getJoint(0)
        position, (x, y, z, w) = self._pose
        self._base_joint.setTransform(
            dartpy.math.Isometry3(dartpy.math.Quaternion(w, x, y, z), list(position))
        )
        self._drives = [self._index(joint) for joint in self.spec.drive_joints]
        self._feet = [robot.getBodyNode(name) for name in self.spec.ground_links]
        self._ground: YieldingGround | None = None
        self._differentials = [
            Differential(robot, coupling, self._timestep_s)
            for coupling in self.spec.couplings
            if is_chained(robot, coupling)
        ]
        if self.spec.sideways_friction_share != 1.0:
            self._grip = Grip(robot, self._feet, self.spec.sideways_friction_share, self._timestep_s)
            self._grip.set_friction(self._foot_friction)
        self._gives = self._giving_way() if self._leads else []
        self._impulses = [0.0] * robot.getNumDofs()
        self._gears = self._gear_up()
        self._geared: Sequence[float] = (0.0,) * len(self._motors)
        self._commands = self.spec.rest_commands()
        self._servos.rest()
        self._push = None
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        return robot

    def _gear_up(self) -> Gears | None:
        couplings = [each for each in self.spec.couplings if not is_chained(self.skeleton, each)]
        if not couplings:
            return None
        return Gears(self.skeleton, couplings, self.spec.drive_joints, self._timestep_s)

    @property
    def _leads(self) -> bool:
        """Whether what servos give way by is made up for: much, where wheels are light beside rotors."""
        return not self._plain and all(
            motor.mode == "velocity" and motor.rotor_inertia_kgm2 > 0.0 for motor in self._motors
        )

    def _giving_way(self) -> list[float]:
        """The speed [rad/s] by which each motor's servo gives way to an impulse of 1 N m s."""
        ease = self.skeleton.getInvMassMatrix().diagonal()[self._drives]
        gives: list[float] = (_SOFTNESS * ease).tolist()
        return gives

    def forget(self) -> None:
        """The scene is gone, and with it the robot."""
        self.skeleton = self._base = self._base_joint = None

    def _index(self, joint: str) -> int:
        index: int = self.skeleton.getJoint(joint).getIndexInSkeleton(0)
        return index

    def drive(self, commands: Sequence[float]) -> None:
        self._commands = commands

    def xy(self) -> tuple[float, float]:
        """Where its base link is, seen from above [m]."""
        x, y = self._base_joint.getPositions()[3:5].tolist()
        return x, y

    def falls(self) -> bool:
        """Whether it comes down faster than it drives down any slope."""
        return bool(self._base_joint.getVelocities()[5] < -_FALL_MPS)

    def begin(self, count: int) -> None:
        """Have the motors take their commands for the next `count` physics steps."""
        if self._plain:
            self.skeleton.setCommands(self._drives, self._commands)
        else:
            self._servos.command(self._commands, count)

    @property
    def has_work_before(self) -> bool:
        """Whether `before` does anything."""
        return self._ground is not None or not self._plain

    def before(self) -> None:
        """Do what the physics step to come asks for."""
        if self._ground is not None:
            self._ground.lead()
        if not self._plain:
            self._act()

    def _act(self) -> None:
        """Have the motors do what they can toward their commands."""
        robot, drives = self.skeleton, self._drives
        angles, speeds = robot.getPositions(drives).tolist(), robot.getVelocities(drives).tolist()
        targets, torques = self._servos.next(angles, speeds)
        if self._gives:
            # For what all of them bear together, as on a slope. For what each bears alone they would push
            # against each other.
            impulses = self._impulses
            mean = sum([impulses[index] for index in drives]) / len(drives)
            targets = [target + give * mean for target, give in zip(targets, self._gives, strict=True)]
        robot.setCommands(drives, targets)
        if self._gears is None:
            robot.setForceUpperLimits(drives, torques)
            robot.setForceLowerLimits(drives, [-torque for torque in torques])
            return
        self._geared = geared = self._gears.on_drives.tolist()
        most = [gear + torque for gear, torque in zip(geared, torques, strict=True)]
        least = [gear - torque for gear, torque in zip(geared, torques, strict=True)]
        robot.setForceUpperLimits(drives, most)
        robot.setForceLowerLimits(drives, least)

    @property
    def has_work_after(self) -> bool:
        """Whether `after` does anything."""
        slips = self.spec.sideways_friction_share != 1.0
        return slips or self._leads or bool(self.spec.couplings) or self._measures_work

    def after(self) -> None:
        """Do what a physics step that was made asks for."""
        if self._gears is not None:
            self._gears.after()
        if self._gives or self._differentials or self._grip is not None:
            self._impulses = impulses = self.skeleton.getJointConstraintImpulses().tolist()
            for differential in self._differentials:
                differential.after(impulses)
            if self._grip is not None:
                self._grip.after(impulses)
        if self._measures_work:
            self._count_work()

    def _count_work(self) -> None:
        speeds = self.skeleton.getVelocities(self._drives).tolist()
        # A torque acts from the speed before a step to the one after it.
        means = [(one + other) / 2 for one, other in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += work_w(self._motors, means, self._torques()) * self._timestep_s

    def work_j(self) -> float:
        done, self._work = self._work, 0.0
        return done

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def pushed(self) -> Sequence[float] | None:
        """The force set by `push` since this was asked last; None where there is none."""
        push, self._push = self._push, None
        return push

    def apply(self, force_w: Sequence[float]) -> None:
        """Have a force (3) [N] act in the physics step to come."""
        # The engine keeps a force in the body's frame, which may turn.
        self._base.setExtForce(force_w, self._base.getLocalCOM(), False, True)

    def let_go(self) -> None:
        """End what `apply` has begun."""
        self._base.clearExternalForces()

    def set_foot_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set what each of the links that it stands on is to the ground; see `set_wheel_contacts`."""
        for foot, grip, bounce in zip(self._feet, friction, restitution, strict=True):
            for node in foot.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(grip)
                    node.getDynamicsAspect().setRestitutionCoeff(bounce)
        if self._grip is not None:
            self._grip.set_friction(friction)
        if stiffness is None or damping is None:
            return
        if self._ground is None:
            self._ground = YieldingGround(self.skeleton, self._feet, self._timestep_s, _SOFTNESS)
        self._ground.set(stiffness, damping)

    def _torques(self) -> list[float]:
        impulses: list[float] = self.skeleton.getJointConstraintImpulses()[self._drives].tolist()
        # In plain numbers: of a state that diverges they overflow without a warning.
        step_s = self._timestep_s
        return [impulse / step_s - geared for impulse, geared in zip(impulses, self._geared, strict=True)]

    def body_state(self) -> tuple[float, ...]:
        # Asking the joint costs a tenth of asking the body for what it derives from it.
        joint = self._base_joint
        rx, ry, rz, px, py, pz = joint.getPositions().tolist()
        ax, ay, az, vx, vy, vz = joint.getVelocities().tolist()
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
        # The second arm of a differential hangs on the first.
        for differential in self._differentials:
            positions[differential.between] += positions[differential.body]
        return tuple(positions[self._index(joint)] for joint in joints)


def _read_robot(spec: RobotBody, text: str | None = None) -> Any:
    robot = parsed(robot_urdf(spec, text), spec.urdf.parent)
    if robot is None:
        raise PhysicsError(f"DART cannot load {spec.urdf}")
    for body in robot.getBodyNodes():
        for node in body.getShapeNodes():
            if node.hasDynamicsAspect():
                node.getDynamicsAspect().setFrictionCoeff(NEVER_THE_LESSER)
    joints = {joint.getName(): joint for joint in robot.getJoints()[1:]}
    for name, joint in joints.items():
        if joint.getNumDofs() == 1:
            joint.setDampingCoefficient(0, 0.0)
            joint.setCoulombFriction(0, 0.0)
            joint.setLimitEnforcement(True)
            # A motor's speed is its own affair.
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
            set_up(robot, coupling)
    return robot


def parsed(urdf: str, folder: Path) -> Any:
    # The reader takes a path as it is: it does not know percent signs.
    return dartpy.utils.DartLoader().parseSkeletonString(urdf, f"file://{folder.resolve()}/")
