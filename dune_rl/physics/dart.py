"""The DART backend."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart_files import TYRE, is_open, robot_urdf, write_meshes
from dune_rl.physics.interface import CAPSULE_FRICTION, RobotBody, SceneSpec, StaticBody
from dune_rl.physics.motors import Servos, work_w
from dune_rl.physics.varied_body import BodyVariation, motors_at, varied_urdf

try:
    import dartpy
except ImportError as error:
    raise PhysicsError(
        "physics=dart needs dartpy, which has wheels for Linux alone: pip install 'dartpy>=6.20,<7'; "
        "physics=bullet runs everywhere"
    ) from error

# DART takes the lesser coefficient of two bodies that touch. The robot's is always the greater, so
# that the other body's, which is the product of both, counts.
_NEVER_THE_LESSER = 1e3

# Four rigid wheels on rigid ground can share a weight in many ways, and servos on one body push against
# each other by any torque at all: a direct solver then has a rover stand on two of its wheels, and turn
# by fits and starts. Tyres that give by less than a millimetre and servos that give way by 0.5 % of a
# rover's speed settle both. The servos' softness is that of every scene in the process.
_TYRE_STIFFNESS_NPM = 1e5
dartpy.constraint.JointConstraint.setConstraintForceMixing(0.07)

_GEAR_TORQUE_NM, _GEAR_RESPONSE = 1e4, 0.2

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0

# Finer takes more of the sweeps and changes no rate of turn by 1 %.
_CONE_TOLERANCE = 1e-3
# Bullet's margin round the triangles of a mesh that is no solid, which spheres alone do not feel.
_TRIANGLE_MARGIN_M = 0.01


class DartScene:
    """One DART world, with Bullet's collision detector and DART's own contact solvers."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._meshes = _shared_meshes(spec.statics)
        self._robot_as_read = _read_robot(spec.robot)
        self._surroundings = _Surroundings(spec, self._meshes, self._robot_as_read)
        self._centre_heights = np.array([body.height_m / 2 for body in spec.kinematics])
        self._cone = _cone_solver(spec.solver_iterations) if spec.friction == "cone" else None
        self._motors = spec.robot.motors
        # Most wheels take a command as it is, once a control step; others need a look in every physics step.
        self._plain = all(motor.is_plain for motor in self._motors)
        self._servos = Servos(self._motors, spec.timestep_s)
        self._push: Sequence[float] | None = None
        self._measures_work = spec.measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()
        self._gears: list[_Gear] = []
        self._world: Any = None

    def set_body(self, variation: BodyVariation) -> None:
        robot = self._spec.robot
        self._motors = motors_at(robot.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._spec.timestep_s)
        text = None if variation.is_of_the_urdf else varied_urdf(robot.urdf, variation)
        self._robot_as_read = _read_robot(replace(robot, motors=self._motors), text)

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # All that remembers is made anew: the robot, the kinematic bodies, and the world with the
        # collision detector's pairs and contacts. Meshes, which are slow to build, remember nothing.
        spec = self._spec
        self._robot = robot = self._robot_as_read.clone()
        self._base, self._base_joint = robot.getBodyNode(0), robot.getJoint(0)
        x, y, z, w = quaternion
        self._base_joint.setTransform(
            dartpy.math.Isometry3(dartpy.math.Quaternion(w, x, y, z), list(position_w))
        )
        self._drives = [self._index(joint) for joint in spec.robot.drive_joints]
        self._feet = [robot.getBodyNode(name) for name in spec.robot.ground_links]
        self._surroundings.take_friction_back()
        self._servos.rest()
        self._push = None
        self._gears = [
            _Gear(self._index(coupling.leader), self._index(coupling.follower), coupling.ratio)
            for coupling in spec.robot.couplings
        ]
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        self._capsules = _Capsules(spec)
        self._rest(self._centres(kinematic_poses))
        self._world = world = dartpy.simulation.World()
        world.setTimeStep(spec.timestep_s)
        world.setGravity([0.0, 0.0, -spec.gravity_mps2])
        sleep = world.getDeactivationOptions()
        sleep.mEnabled = False
        world.setDeactivationOptions(sleep)
        solver = world.getConstraintSolver()
        solver.setCollisionDetector(self._meshes.detector)
        if self._cone is not None:
            solver.setBoxedLcpSolver(self._cone)
        self._filter = solver.getCollisionOption().collisionFilter
        self._part(self._filter)
        for skeleton in (self._surroundings.skeleton, self._capsules.skeleton, robot):
            world.addSkeleton(skeleton)

    def _index(self, joint: str) -> int:
        index: int = self._robot.getJoint(joint).getIndexInSkeleton(0)
        return index

    def _part(self, collision_filter: Any) -> None:
        """Say who does not meet whom."""
        for_feet = [self._surroundings.for_feet, *self._capsules.for_feet]
        for_hull = [self._surroundings.for_hull, self._surroundings.obstacles, *self._capsules.for_hull]
        for_feet += self._surroundings.obstacles_for_feet
        for body in self._robot.getBodyNodes():
            stands = body.getName() in self._spec.robot.ground_links
            for stranger in for_hull if stands else for_feet:
                collision_filter.addBodyNodePairToBlackList(body, stranger)
        for capsule in (*self._capsules.for_hull, *self._capsules.for_feet):
            for stranger in self._surroundings.skeleton.getBodyNodes():
                collision_filter.addBodyNodePairToBlackList(capsule, stranger)

    def _centres(self, kinematic_poses: NDArray[np.float64]) -> NDArray[np.float64]:
        centres = kinematic_poses[:, :3].copy()
        centres[:, 2] += self._centre_heights
        return centres

    def _rest(self, centres: NDArray[np.float64]) -> None:
        capsules, still = self._capsules.skeleton, np.zeros(centres.size)
        self._capsule_centres = centres
        capsules.setPositions(centres.ravel())
        capsules.setVelocities(still)
        capsules.setCommands(still)

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        push, self._push = self._push, None
        self._forget_contacts()
        if self._plain:
            self._robot.setCommands(self._drives, commands)
        else:
            self._servos.command(commands, count)
        if not len(kinematic_poses):
            self._advance(count, push)
            return
        centres = self._centres(kinematic_poses)
        x, y = self._base_joint.getPositions()[3:5]
        near = np.abs(centres[:, :2] - (x, y)).max(axis=1) < _NEAR_M
        start = np.where(near[:, None], self._capsule_centres, centres)
        self._capsules.skeleton.setPositions(start.ravel())
        # They move at these speeds by themselves, and what they meet feels it.
        speeds = (centres - start).ravel() / (count * self._spec.timestep_s)
        self._capsules.skeleton.setCommands(speeds)
        self._advance(count, push)
        self._rest(centres)

    def _forget_contacts(self) -> None:
        """Have the detector find all contacts anew in the next physics step.

        It does so by itself whenever a body is made anywhere in the process: when another scene begins an
        episode, say. Contacts kept for longer than a step would depend on that in their last bits.
        """
        # Any change of the filter does it; that a body does not meet itself is none.
        self._filter.addBodyNodePairToBlackList(self._base, self._base)

    def _advance(self, count: int, push: Sequence[float] | None) -> None:
        if push is None:
            self.coast(count)
            return
        base, centre = self._base, self._base.getLocalCOM()
        for _ in range(count):
            # The engine keeps a force in the body's frame, which may turn.
            base.setExtForce(push, centre, False, True)
            self.coast(1)
        base.clearExternalForces()

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        # Of the four, grip alone: DART's contacts are rigid, and its tyres are too light to bounce as stated.
        ground = self._surroundings.give_friction_to_feet()
        for number, foot in enumerate(self._feet):
            for node in foot.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(friction[number] * ground)

    def coast(self, count: int) -> None:
        advance = self._world.step
        for _ in range(count):
            if not self._plain:
                self._drive()
            # False: joints keep their commands.
            advance(False)
            if self._gears:
                self._react()
            if self._measures_work:
                self._count_work()

    def _react(self) -> None:
        """Have the leaders of couplings feel what their followers take."""
        impulses = self._robot.getJointConstraintImpulses()
        for gear in self._gears:
            wanted = -gear.ratio * impulses[gear.follower] / self._spec.timestep_s
            # At once, the torque of one step on the motion of the next would swing up.
            gear.torque_nm += _GEAR_RESPONSE * (wanted - gear.torque_nm)
            self._robot.setCommand(gear.leader, gear.torque_nm)

    def _count_work(self) -> None:
        speeds = self._robot.getVelocities(self._drives).tolist()
        # A torque acts from the speed before a step to the one after it.
        means = [(one + other) / 2 for one, other in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += work_w(self._motors, means, self._torques()) * self._spec.timestep_s

    def work_j(self) -> float:
        done, self._work = self._work, 0.0
        return done

    def _torques(self) -> list[float]:
        impulses: list[float] = self._robot.getJointConstraintImpulses()[self._drives].tolist()
        # In plain numbers: of a state that diverges they overflow without a warning.
        return [impulse / self._spec.timestep_s for impulse in impulses]

    def _drive(self) -> None:
        """Have the motors do what they can toward their commands in the next physics step."""
        robot, drives = self._robot, self._drives
        angles, speeds = robot.getPositions(drives).tolist(), robot.getVelocities(drives).tolist()
        targets, torques = self._servos.next(angles, speeds)
        robot.setCommands(drives, targets)
        robot.setForceUpperLimits(drives, torques)
        robot.setForceLowerLimits(drives, [-torque for torque in torques])

    def body_state(self) -> tuple[float, ...]:
        # Asking the joint costs a tenth of asking the body for what it derives from it.
        joint = self._base_joint
        rx, ry, rz, px, py, pz = joint.getPositions().tolist()
        ax, ay, az, vx, vy, vz = joint.getVelocities().tolist()
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
        return (px, py, pz, scale * rx, scale * ry, scale * rz, math.cos(angle / 2), vx, vy, vz, ax, ay, az)

    def drive_state(self) -> tuple[float, ...]:
        robot, drives = self._robot, self._drives
        return (
            *robot.getPositions(drives).tolist(),
            *robot.getVelocities(drives).tolist(),
            *self._torques(),
        )

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return tuple(self._robot.getPositions([self._index(joint) for joint in joints]).tolist())

    def touched(self) -> list[int]:
        met = self._world.getLastCollisionResult().inCollision
        return [*self._surroundings.touched(met), *self._capsules.touched(met)]

    def close(self) -> None:
        # What the engine holds goes with the last reference to it.
        self._world = self._robot = self._base = self._base_joint = None


@dataclass
class _Gear:
    leader: int
    follower: int
    ratio: float
    torque_nm: float = 0.0


def _cone_solver(sweeps: int) -> Any:
    options = dartpy.constraint.NsgsFrictionSolver.Options()
    options.maxSweeps, options.tolerance = sweeps, _CONE_TOLERANCE
    return dartpy.constraint.NsgsFrictionSolver(options)


class _Surroundings:
    """Everything that never moves, in one skeleton.

    The ground is there twice, for links that stand on it and for the hull, as
    each pair has a friction of its own; so are obstacles, where feet meet them.
    """

    def __init__(self, spec: SceneSpec, meshes: "_Meshes", robot: Any) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("statics")
        self.for_feet, self.for_hull, self.obstacles = (self._body() for _ in range(3))
        self.obstacles_for_feet = [self._body()] if spec.robot.ground_links_meet_obstacles else []
        self._numbered: list[tuple[int, Any]] = []
        self._underfoot: list[tuple[Any, float]] = []
        self._given = False
        self._terrain_friction = next((body.friction for body in spec.statics if body.ground), 1.0)
        gap_of_feet, gap_of_hull = (_contact_gap(robot, spec.robot, feet=feet) for feet in (True, False))
        for number, (body, shape) in enumerate(zip(spec.statics, meshes.shapes, strict=True)):
            feet_friction = body.friction * spec.robot.ground_friction
            hull_friction = body.friction * spec.robot.hull_friction
            if body.ground:
                hollow = meshes.hollow[number]
                raised = -gap_of_feet * hollow
                node = _add_shape(self.for_feet, shape, feet_friction, raised)
                self._underfoot.append((node, feet_friction))
                _add_shape(self.for_hull, shape, hull_friction, -gap_of_hull * hollow)
                continue
            self._numbered.append((number, _add_shape(self.obstacles, shape, hull_friction)))
            for other in self.obstacles_for_feet:
                self._numbered.append((number, _add_shape(other, shape, feet_friction)))
        self.skeleton.setMobile(False)

    def give_friction_to_feet(self) -> float:
        """Let links that stand on the ground say what friction they have there; returns the ground's own."""
        if not self._given:
            self._given = True
            for node, _ in self._underfoot:
                node.getDynamicsAspect().setFrictionCoeff(_NEVER_THE_LESSER)
        return self._terrain_friction

    def take_friction_back(self) -> None:
        """Undo `give_friction_to_feet`."""
        if self._given:
            self._given = False
            for node, friction in self._underfoot:
                node.getDynamicsAspect().setFrictionCoeff(friction)

    def _body(self) -> Any:
        return self.skeleton.createWeldJointAndBodyNodePair()[1]

    def touched(self, met: Any) -> list[int]:
        """Numbers of the obstacles that are `met`."""
        if not any(met(body) for body in (self.obstacles, *self.obstacles_for_feet)):
            return []
        return [number for number, shape in self._numbered if met(shape)]


class _Capsules:
    """Bodies that move at the speed they are told, whatever they meet; they never turn."""

    def __init__(self, spec: SceneSpec) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("kinematics")
        self.for_hull: list[Any] = []
        self.for_feet: list[Any] = []
        self._first = len(spec.statics)
        for body in spec.kinematics:
            joint, node = self.skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            shape = dartpy.dynamics.CapsuleShape(body.radius_m, body.height_m - 2 * body.radius_m)
            _add_shape(node, shape, CAPSULE_FRICTION * spec.robot.hull_friction)
            self.for_hull.append(node)
            if spec.robot.ground_links_meet_obstacles:
                _, other = self.skeleton.createWeldJointAndBodyNodePair(node)
                _add_shape(other, shape, CAPSULE_FRICTION * spec.robot.ground_friction)
                self.for_feet.append(other)

    def touched(self, met: Any) -> list[int]:
        """Numbers of the bodies that are `met`."""
        return [
            self._first + number
            for bodies in (self.for_hull, self.for_feet)
            for number, body in enumerate(bodies)
            if met(body)
        ]


def _contact_gap(robot: Any, spec: RobotBody, *, feet: bool) -> float:
    """How far the detector holds the feet, or the other links, off triangles that are no solid [m]."""
    bodies = [body for body in robot.getBodyNodes() if (body.getName() in spec.ground_links) == feet]
    shapes = [
        node.getShape() for body in bodies for node in body.getShapeNodes() if node.hasCollisionAspect()
    ]
    spheres = [isinstance(shape, dartpy.dynamics.SphereShape) for shape in shapes]
    return 0.0 if all(spheres) else _TRIANGLE_MARGIN_M


def _add_shape(body: Any, shape: Any, friction: float, raised_m: float = 0.0) -> Any:
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTranslation([0.0, 0.0, raised_m])
    return node


def _read_robot(spec: RobotBody, text: str | None = None) -> Any:
    robot = _parsed(robot_urdf(spec, text), spec.urdf.parent)
    if robot is None:
        raise PhysicsError(f"DART cannot load {spec.urdf}")
    for body in robot.getBodyNodes():
        for node in body.getShapeNodes():
            if node.hasDynamicsAspect():
                node.getDynamicsAspect().setFrictionCoeff(_NEVER_THE_LESSER)
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
        if coupling.leader in spec.drive_joints:
            raise PhysicsError(
                f"{spec.urdf.name}: physics=dart couples joints without motors alone, and {coupling.leader} "
                "has one; take physics=bullet"
            )
        leader, follower = joints[coupling.leader], joints[coupling.follower]
        # DART drives the follower after the leader, which feels nothing of it by itself: see `_gear`. What
        # holds the one holds the other, so that the leader has the friction and the damping of both.
        share = abs(coupling.ratio)
        friction = leader.getCoulombFriction(0) + share * follower.getCoulombFriction(0)
        damping = leader.getDampingCoefficient(0) + share**2 * follower.getDampingCoefficient(0)
        leader.setCoulombFriction(0, friction)
        leader.setDampingCoefficient(0, damping)
        follower.setCoulombFriction(0, 0.0)
        follower.setDampingCoefficient(0, 0.0)
        follower.setLimitEnforcement(False)
        follower.setUseCouplerConstraint(False)
        follower.setForceLowerLimit(0, -_GEAR_TORQUE_NM)
        follower.setForceUpperLimit(0, _GEAR_TORQUE_NM)
    return robot


def _parsed(urdf: str, folder: Path) -> Any:
    # The reader takes a path as it is: it does not know percent signs.
    return dartpy.utils.DartLoader().parseSkeletonString(urdf, f"file://{folder.resolve()}/")


class _Meshes:
    """The shapes of static bodies, and the detector that has built its trees of them."""

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        self.statics = statics
        self.detector = dartpy.collision.BulletCollisionDetector()
        self.hollow = [is_open(body) for body in statics]
        self.shapes = self._read()
        # The detector forgets a mesh that is in no group.
        self._holder = dartpy.dynamics.Skeleton("meshes")
        body = self._holder.createWeldJointAndBodyNodePair()[1]
        for shape in self.shapes:
            _add_shape(body, shape, 0.0)
        self._group = self.detector.createCollisionGroup()
        self._group.addShapeFrames([*body.getShapeNodes()])

    def _read(self) -> list[Any]:
        if not self.statics:
            return []
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            read = _parsed(write_meshes(self.statics, self.hollow, folder), folder)
            nodes = [] if read is None else read.getBodyNode(0).getShapeNodes()
            if len(nodes) != len(self.statics):
                raise PhysicsError(
                    f"DART read {len(nodes)} of {len(self.statics)} meshes from {folder}; "
                    "set TMPDIR to a folder with room"
                )
            return [node.getShape() for node in nodes]


# Scenes of one batch have the same statics; each entry lives as long as one of them does, and holds
# the statics, so that no others can have their address.
_in_use: WeakValueDictionary[int, _Meshes] = WeakValueDictionary()


def _shared_meshes(statics: tuple[StaticBody, ...]) -> _Meshes:
    meshes = _in_use.get(id(statics))
    if meshes is None:
        _in_use[id(statics)] = meshes = _Meshes(statics)
    return meshes
