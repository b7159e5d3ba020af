"""The DART backend."""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.interface import (
    CAPSULE_FRICTION,
    HULL_FRICTION,
    KinematicCapsule,
    RobotBody,
    SceneSpec,
    StaticBody,
)

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

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0

# Finer takes more of the sweeps and changes no rate of turn by 1 %.
_CONE_TOLERANCE = 1e-3
# Bullet's margin round the triangles of a mesh that is no solid, which spheres alone do not feel.
_TRIANGLE_MARGIN_M = 0.01
_FOLD_DEPTH_M = 10.0


class DartScene:
    """One DART world, with Bullet's collision detector and DART's own contact solvers."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._meshes = _shared_meshes(spec.statics)
        self._robot_as_read = _read_robot(spec.robot)
        self._ground = _Ground(spec, self._meshes, self._robot_as_read)
        self._centre_heights = np.array([body.height_m / 2 for body in spec.kinematics])
        self._first_kinematic = len(spec.statics)
        self._cone = _cone_solver(spec.solver_iterations) if spec.friction == "cone" else None
        self._world: Any = None
        self._push: Sequence[float] | None = None

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # All that remembers is made anew: the robot, the kinematic bodies, and the world with the
        # collision detector's pairs and contacts. Meshes, which are slow to build, remember nothing.
        spec, self._push = self._spec, None
        self._robot = robot = self._robot_as_read.clone()
        self._base_joint = robot.getJoint(0)
        x, y, z, w = quaternion
        self._base_joint.setTransform(
            dartpy.math.Isometry3(dartpy.math.Quaternion(w, x, y, z), list(position_w))
        )
        self._base = robot.getBodyNode(0)
        self._drives = [robot.getJoint(name).getIndexInSkeleton(0) for name in spec.robot.drive_joints]
        self._capsules = _capsules(spec.kinematics)
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
        self._part(solver.getCollisionOption().collisionFilter)
        for skeleton in (self._ground.skeleton, self._capsules, robot):
            world.addSkeleton(skeleton)

    def _part(self, collision_filter: Any) -> None:
        """Say who does not meet whom."""
        ground, capsules = self._ground, self._capsules.getBodyNodes()
        drives = set(self._spec.robot.drive_joints)
        for body in self._robot.getBodyNodes():
            if body.getParentJoint().getName() in drives:
                strangers = [ground.under_hull, ground.obstacles, *capsules]
            else:
                strangers = [ground.under_wheels]
            for stranger in strangers:
                collision_filter.addBodyNodePairToBlackList(body, stranger)
        for capsule in capsules:
            for stranger in (ground.under_wheels, ground.under_hull, ground.obstacles):
                collision_filter.addBodyNodePairToBlackList(capsule, stranger)

    def _centres(self, kinematic_poses: NDArray[np.float64]) -> NDArray[np.float64]:
        centres = kinematic_poses[:, :3].copy()
        centres[:, 2] += self._centre_heights
        return centres

    def _rest(self, centres: NDArray[np.float64]) -> None:
        self._capsule_centres = centres
        self._capsules.setPositions(centres.ravel())
        still = np.zeros(centres.size)
        self._capsules.setVelocities(still)
        self._capsules.setCommands(still)

    def step(
        self, count: int, drive_velocities: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        push, self._push = self._push, None
        self._robot.setCommands(self._drives, drive_velocities)
        if not len(kinematic_poses):
            self._advance(count, push)
            return
        centres = self._centres(kinematic_poses)
        x, y = self._base_joint.getPositions()[3:5]
        near = np.abs(centres[:, :2] - (x, y)).max(axis=1) < _NEAR_M
        start = np.where(near[:, None], self._capsule_centres, centres)
        self._capsules.setPositions(start.ravel())
        # They move at these speeds by themselves, and what they meet feels it.
        self._capsules.setCommands((centres - start).ravel() / (count * self._spec.timestep_s))
        self._advance(count, push)
        self._rest(centres)

    def _advance(self, count: int, push: Sequence[float] | None) -> None:
        if push is None:
            self.coast(count)
            return
        base, advance, centre = self._base, self._world.step, self._base.getLocalCOM()
        for _ in range(count):
            # The engine keeps a force in the body's frame, which may turn.
            base.setExtForce(push, centre, False, True)
            advance(False)
        base.clearExternalForces()

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def coast(self, count: int) -> None:
        advance = self._world.step
        for _ in range(count):
            # False: joints keep their commands.
            advance(False)

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
            *(robot.getJointConstraintImpulses()[drives] / self._spec.timestep_s).tolist(),
        )

    def touched(self) -> list[int]:
        # Obstacles and kinematic bodies meet nothing but the hull.
        met = self._world.getLastCollisionResult().inCollision
        found = self._ground.numbers(met)
        for number, body in enumerate(self._capsules.getBodyNodes(), start=self._first_kinematic):
            if met(body):
                found.append(number)
        return found

    def close(self) -> None:
        self._world = self._robot = self._base = self._base_joint = self._capsules = None


def _cone_solver(sweeps: int) -> Any:
    options = dartpy.constraint.NsgsFrictionSolver.Options()
    options.maxSweeps, options.tolerance = sweeps, _CONE_TOLERANCE
    return dartpy.constraint.NsgsFrictionSolver(options)


class _Ground:
    """Everything that never moves, in one skeleton of three bodies.

    The ground is there twice, for wheels and for the hull, as each pair has a
    friction of its own; obstacles are for the hull alone.
    """

    def __init__(self, spec: SceneSpec, meshes: "_Meshes", robot: Any) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("statics")
        self.under_wheels, self.under_hull, self.obstacles = (
            self.skeleton.createWeldJointAndBodyNodePair()[1] for _ in range(3)
        )
        self._numbered = []
        wheel_gap, hull_gap = (_contact_gap(robot, spec.robot, wheels=wheels) for wheels in (True, False))
        wheel_friction = spec.robot.wheel_friction
        for number, (body, shape) in enumerate(zip(spec.statics, meshes.shapes, strict=True)):
            if body.ground:
                hollow = meshes.hollow[number]
                wheels = _add_shape(self.under_wheels, shape, body.friction * wheel_friction)
                wheels.setRelativeTranslation([0.0, 0.0, -wheel_gap * hollow])
                hull = _add_shape(self.under_hull, shape, body.friction * HULL_FRICTION)
                hull.setRelativeTranslation([0.0, 0.0, -hull_gap * hollow])
            else:
                self._numbered.append(
                    (number, _add_shape(self.obstacles, shape, body.friction * HULL_FRICTION))
                )
        self.skeleton.setMobile(False)

    def numbers(self, met: Any) -> list[int]:
        """Numbers of the obstacles that are `met`."""
        if not met(self.obstacles):
            return []
        return [number for number, shape in self._numbered if met(shape)]


def _contact_gap(robot: Any, spec: RobotBody, *, wheels: bool) -> float:
    """How far the detector holds the wheels, or the other links, off triangles that are no solid [m]."""
    bodies = [
        body
        for body in robot.getBodyNodes()
        if (body.getParentJoint().getName() in spec.drive_joints) == wheels
    ]
    shapes = [
        node.getShape() for body in bodies for node in body.getShapeNodes() if node.hasCollisionAspect()
    ]
    spheres = [isinstance(shape, dartpy.dynamics.SphereShape) for shape in shapes]
    return 0.0 if all(spheres) else _TRIANGLE_MARGIN_M


def _add_shape(body: Any, shape: Any, friction: float) -> Any:
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    return node


def _capsules(bodies: Sequence[KinematicCapsule]) -> Any:
    """Bodies that move at the speed they are told, whatever they meet; they never turn."""
    skeleton = dartpy.dynamics.Skeleton("kinematics")
    for body in bodies:
        joint, node = skeleton.createTranslationalJointAndBodyNodePair()
        joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
        shape = dartpy.dynamics.CapsuleShape(body.radius_m, body.height_m - 2 * body.radius_m)
        _add_shape(node, shape, CAPSULE_FRICTION * HULL_FRICTION)
    return skeleton


def _read_robot(spec: RobotBody) -> Any:
    robot = _parsed(spec.urdf) if spec.urdf.is_file() else None
    if robot is None:
        raise PhysicsError(f"DART cannot load {spec.urdf}")
    joints = {joint.getName(): joint for joint in robot.getJoints() if joint.getNumDofs() == 1}
    missing = [name for name in spec.drive_joints if name not in joints]
    if missing:
        raise PhysicsError(f"{spec.urdf.name} has no joint {', '.join(missing)}; it has {', '.join(joints)}")
    for body in robot.getBodyNodes():
        for node in body.getShapeNodes():
            if node.hasDynamicsAspect():
                node.getDynamicsAspect().setFrictionCoeff(_NEVER_THE_LESSER)
    for name, joint in joints.items():
        joint.setDampingCoefficient(0, 0.0)
        joint.setCoulombFriction(0, 0.0)
        joint.setLimitEnforcement(True)
        if name in spec.drive_joints:
            joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
            joint.setForceLowerLimit(0, -spec.max_torque_nm)
            joint.setForceUpperLimit(0, spec.max_torque_nm)
    return robot


def _parsed(urdf: Path) -> Any:
    # The reader takes a path as it is: it does not know percent signs.
    return dartpy.utils.DartLoader().parseSkeleton(f"file://{urdf.resolve()}")


class _Meshes:
    """The shapes of static bodies, and the detector that has built its trees of them."""

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        self.statics = statics
        self.detector = dartpy.collision.BulletCollisionDetector()
        self.hollow = [_is_open(body) for body in statics]
        self.shapes = _read_meshes(statics, self.hollow)
        # The detector forgets a mesh that is in no group.
        self._holder = dartpy.dynamics.Skeleton("meshes")
        body = self._holder.createWeldJointAndBodyNodePair()[1]
        for shape in self.shapes:
            _add_shape(body, shape, 0.0)
        self._group = self.detector.createCollisionGroup()
        self._group.addShapeFrames([*body.getShapeNodes()])


# Scenes of one batch have the same statics; each entry lives as long as one of them does, and holds
# the statics, so that no others can have their address.
_in_use: WeakValueDictionary[int, _Meshes] = WeakValueDictionary()


def _shared_meshes(statics: tuple[StaticBody, ...]) -> _Meshes:
    meshes = _in_use.get(id(statics))
    if meshes is None:
        _in_use[id(statics)] = meshes = _Meshes(statics)
    return meshes


def _read_meshes(statics: Sequence[StaticBody], hollow: Sequence[bool]) -> list[Any]:
    """Shapes of triangles, which DART reads from files alone."""
    if not statics:
        return []
    with tempfile.TemporaryDirectory() as folder:
        elements = []
        for number, body in enumerate(statics):
            path = Path(folder).resolve() / f"{number}.stl"
            path.write_bytes(_stl(_folded(body) if hollow[number] else body.vertices[body.faces]))
            elements.append(f'<collision><geometry><mesh filename="file://{path}"/></geometry></collision>')
        urdf = Path(folder) / "statics.urdf"
        urdf.write_text(f'<robot name="statics"><link name="statics">{"".join(elements)}</link></robot>')
        read = _parsed(urdf)
    nodes = [] if read is None else read.getBodyNode(0).getShapeNodes()
    if len(nodes) != len(statics):
        raise PhysicsError(f"DART read {len(nodes)} of {len(statics)} meshes; is {folder} writable?")
    return [node.getShape() for node in nodes]


def _is_open(body: StaticBody) -> bool:
    """Whether it is a surface with a border, and not a closed solid."""
    edges = np.sort(body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 1).any())


def _folded(body: StaticBody) -> NDArray[np.float64]:
    """Corners (F, 3, 3) of a surface's triangles, and of a fold far below it.

    Flat ground would otherwise be taken for a convex solid, whose vertices are
    all searched at every contact.
    """
    x, y = body.vertices[:, :2].mean(axis=0)
    below = [x, y, body.vertices[:, 2].min() - _FOLD_DEPTH_M]
    fold = np.array([[[0, 0, 0], [1, 0, 1], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [-1, 0, 1]]])
    return np.concatenate([body.vertices[body.faces], fold + below])


def _stl(corners: NDArray[np.float64]) -> bytes:
    """Triangles (F, 3, 3) as a binary STL file."""
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    return bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()
