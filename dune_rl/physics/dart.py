"""The DART backend."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.interface import SceneSpec, StaticBody

try:
    import dartpy
except ImportError as error:
    raise PhysicsError(
        "physics.backend=dart needs dartpy: pip install 'dartpy>=6.13,<7' (wheels are for Linux); "
        "or take physics=bullet"
    ) from error

# DART takes the lesser of two coefficients. What the robot's are multiplied into is the other body's.
_NEVER_THE_LESSER = 1e3

_HULL_FRICTION = 0.3
_CAPSULE_FRICTION = 0.5
# A kinematic body farther than this from the robot jumps at once: it cannot touch the robot before the next step.
_NEAR_M = 2.0


class DartScene:
    """One DART world, with Bullet's collision detection and DART's own solver."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._detector = dartpy.collision.BulletCollisionDetector()
        self._statics = dartpy.dynamics.Skeleton("statics")
        self._wheel_ground, self._hull_ground, self._obstacles = (
            self._statics.createWeldJointAndBodyNodePair()[1] for _ in range(3)
        )
        self._numbered = []
        for number, body in enumerate(spec.statics):
            shape = _mesh(body)
            if body.ground:
                _add_shape(self._wheel_ground, shape, body.friction * spec.robot.wheel_friction)
                _add_shape(self._hull_ground, shape, body.friction * _HULL_FRICTION)
            else:
                node = _add_shape(self._obstacles, shape, body.friction * _HULL_FRICTION)
                self._numbered.append((number, node))
        self._statics.setMobile(False)
        # The detector forgets a mesh that no group holds, and takes milliseconds to build it again.
        self._keeper = self._detector.createCollisionGroup()
        self._keeper.addShapeFramesOf(self._statics)
        self._robot_template = self._load_robot()
        self._world = None

    def _load_robot(self):
        spec = self._spec.robot
        robot = dartpy.utils.DartLoader().parseSkeleton(spec.urdf.as_uri()) if spec.urdf.exists() else None
        if robot is None:
            raise PhysicsError(f"DART cannot load {spec.urdf}")
        names = [joint.getName() for joint in robot.getJoints()[1:]]
        missing = [name for name in spec.drive_joints if name not in names]
        if missing:
            raise PhysicsError(
                f"{spec.urdf.name} has no joint {', '.join(missing)}; it has {', '.join(names)}"
            )
        for body in robot.getBodyNodes():
            for node in body.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(_NEVER_THE_LESSER)
                    node.getDynamicsAspect().setRestitutionCoeff(0.0)
        for joint in robot.getJoints()[1:]:
            if joint.getNumDofs() != 1:
                continue
            joint.setDampingCoefficient(0, 0.0)
            joint.setCoulombFriction(0, 0.0)
            joint.setLimitEnforcement(True)
        for name in spec.drive_joints:
            joint = robot.getJoint(name)
            joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
            joint.setForceLowerLimit(0, -spec.max_torque_nm)
            joint.setForceUpperLimit(0, spec.max_torque_nm)
        return robot

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # All that remembers is made anew: the collision world and its caches, the robot, the actors.
        self._robot = robot = self._robot_template.clone()
        x, y, z, w = quaternion
        turn = dartpy.math.Quaternion(w, x, y, z)
        robot.getJoint(0).setTransform(dartpy.math.Isometry3(turn, list(position_w)))
        self._base = robot.getBodyNode(0)
        self._drives = [robot.getJoint(name) for name in self._spec.robot.drive_joints]
        self._drive_indices = [j.getIndexInSkeleton(0) for j in self._drives]
        self._capsules = self._new_capsules()
        self._rows = np.zeros(3 * len(self._spec.kinematics))
        self._world = world = dartpy.simulation.World()
        world.setTimeStep(self._spec.timestep_s)
        world.setGravity([0.0, 0.0, -self._spec.gravity_mps2])
        idle = world.getDeactivationOptions()
        idle.mEnabled = False
        world.setDeactivationOptions(idle)
        solver = world.getConstraintSolver()
        solver.setCollisionDetector(self._detector)
        self._set_filter(solver.getCollisionOption().collisionFilter)
        self._move(kinematic_poses)
        for skeleton in (self._statics, self._capsules, robot):
            world.addSkeleton(skeleton)
        self._push: Sequence[float] | None = None

    def _new_capsules(self):
        skeleton = dartpy.dynamics.Skeleton("kinematics")
        for body in self._spec.kinematics:
            joint, node = skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            shape = dartpy.dynamics.CapsuleShape(body.radius_m, body.height_m - 2 * body.radius_m)
            _add_shape(node, shape, _CAPSULE_FRICTION * _HULL_FRICTION)
        self._centres = np.array([[0.0, 0.0, b.height_m / 2] for b in self._spec.kinematics]).reshape(-1, 3)
        return skeleton

    def _set_filter(self, told):
        capsules = list(self._capsules.getBodyNodes())
        drives = set(self._spec.robot.drive_joints)
        for body in self._robot.getBodyNodes():
            wheel = body.getParentJoint().getName() in drives
            others = [self._hull_ground, self._obstacles, *capsules] if wheel else [self._wheel_ground]
            for other in others:
                told.addBodyNodePairToBlackList(body, other)
        for capsule in capsules:
            for other in (self._wheel_ground, self._hull_ground, self._obstacles):
                told.addBodyNodePairToBlackList(capsule, other)

    def _move(self, poses):
        self._rows = (poses[:, :3] + self._centres).ravel()
        self._capsules.setPositions(self._rows)
        self._capsules.setVelocities(np.zeros_like(self._rows))
        self._capsules.setCommands(np.zeros_like(self._rows))

    def step(
        self, count: int, drive_velocities: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        push, self._push = self._push, None
        self._robot.setCommands(self._drive_indices, drive_velocities)
        if len(self._rows):
            rows = (kinematic_poses[:, :3] + self._centres).ravel()
            x, y, _ = self._base.getWorldTransform().translation()
            near = (np.abs(kinematic_poses[:, 0] - x) < _NEAR_M) & (np.abs(kinematic_poses[:, 1] - y) < _NEAR_M)
            start = np.where(np.repeat(near, 3), self._rows, rows)
            self._capsules.setPositions(start)
            self._capsules.setCommands((rows - start) / (count * self._spec.timestep_s))
        advance = self._world.step
        if push is None:
            for _ in range(count):
                advance(False)
        else:
            for _ in range(count):
                self._base.setExtForce(push, [0.0, 0.0, 0.0], False, True)
                advance(False)
            self._base.clearExternalForces()
        if len(self._rows):
            self._move(kinematic_poses)

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def coast(self, count: int) -> None:
        advance = self._world.step
        for _ in range(count):
            advance(False)

    def body_state(self) -> tuple[float, ...]:
        base = self._base
        pose = base.getWorldTransform()
        return (
            *pose.translation().tolist(),
            *pose.quaternion().xyz().tolist(),
            pose.quaternion().w(),
            *base.getLinearVelocity().tolist(),
            *base.getAngularVelocity().tolist(),
        )

    def drive_state(self) -> tuple[float, ...]:
        robot, indices = self._robot, self._drive_indices
        return (
            *robot.getPositions(indices).tolist(),
            *robot.getVelocities(indices).tolist(),
            *robot.getForces(indices).tolist(),
        )

    def touched(self) -> list[int]:
        met = self._world.getLastCollisionResult().inCollision
        found = []
        if met(self._obstacles):
            found = [number for number, node in self._numbered if met(node)]
        first = len(self._spec.statics)
        return found + [first + i for i, body in enumerate(self._capsules.getBodyNodes()) if met(body)]

    def close(self) -> None:
        self._world = self._robot = self._base = self._capsules = None


def _add_shape(body, shape, friction):
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    return node


def _mesh(body: StaticBody):
    """A shape of a body's triangles, which DART reads from files only."""
    corners = body.vertices[body.faces]
    if _is_open(body.faces):
        # Flat or bulging ground would be taken for a convex solid, and all its vertices be searched at every
        # contact. A triangle that faces up from far below makes a hollow of it.
        low, middle = body.vertices.min(axis=0), body.vertices.mean(axis=0)
        hidden = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]) + [*middle[:2], low[2] - 10.0]
        corners = np.concatenate([corners, hidden[None]])
    triangles = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    triangles["corners"] = corners
    with tempfile.TemporaryDirectory() as folder:
        mesh, urdf = Path(folder, "body.stl"), Path(folder, "body.urdf")
        mesh.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + triangles.tobytes())
        urdf.write_text(
            f'<robot name="body"><link name="body"><collision><geometry>'
            f'<mesh filename="{mesh.as_uri()}"/></geometry></collision></link></robot>'
        )
        read = dartpy.utils.DartLoader().parseSkeleton(urdf.as_uri())
    return read.getBodyNode(0).getShapeNode(0).getShape()


def _is_open(faces) -> bool:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 1).any())
