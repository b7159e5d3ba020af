"""The PyBullet backend."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.interface import (
    CAPSULE_FRICTION,
    HULL_FRICTION,
    KinematicCapsule,
    SceneSpec,
    StaticBody,
)
from dune_rl.physics.quiet import silent_stderr

with silent_stderr():
    import pybullet

# Collision groups. Spheres stand in for wheels; they are wider than the tyres
# they stand for, so they roll on the ground and leave obstacles to the hull.
_GROUND, _WHEEL, _HULL, _OBSTACLE = 1, 2, 4, 8

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0
_TOUCH_M = 1e-3


class BulletScene:
    """One PyBullet client in DIRECT mode."""

    def __init__(self, spec: SceneSpec) -> None:
        if not pybullet.isNumpyEnabled():
            raise PhysicsError(
                "this PyBullet was built without NumPy; install the wheel: pip install pybullet"
            )
        if spec.friction != "pyramid":
            raise PhysicsError(
                "PyBullet's friction cone turns robots at rates that depend on their heading; "
                "take physics.friction=pyramid, or physics=dart"
            )
        self._spec = spec
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise PhysicsError("PyBullet opened no further client in this process; use fewer scenes")
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=spec.timestep_s,
            numSolverIterations=spec.solver_iterations,
            # Both are needed for bit-identical runs: pairs in a fixed order, no mesh of another world.
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            # The cone, which is the default, makes skid-steer turn at a rate that depends on the heading.
            enableConeFriction=0,
            physicsClientId=self._client,
        )
        pybullet.setGravity(0.0, 0.0, -spec.gravity_mps2, physicsClientId=self._client)
        self._numbers: dict[int, int] = {}
        for number, body in enumerate(spec.statics):
            handle = self._add_static(body)
            if not body.ground:
                self._numbers[handle] = number
        self._kinematics = [self._add_capsule(body) for body in spec.kinematics]
        self._centre_heights = [body.height_m / 2 for body in spec.kinematics]
        for number, handle in enumerate(self._kinematics, start=len(spec.statics)):
            self._numbers[handle] = number
        self._poses = np.zeros((len(self._kinematics), 4))
        self._robot: int | None = None
        self._push: Sequence[float] | None = None
        self._drive_joints: list[int] = []
        self._torques = [spec.robot.max_torque_nm] * len(spec.robot.drive_joints)

    def _add_static(self, body: StaticBody) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=body.vertices.tolist(),
            indices=body.faces.ravel().tolist(),
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=self._client,
        )
        if shape < 0:
            raise PhysicsError(f"PyBullet refused the mesh of {body.name!r} ({len(body.faces)} faces)")
        handle: int = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        group = _GROUND if body.ground else _OBSTACLE
        mask = _WHEEL | _HULL if body.ground else _HULL
        pybullet.setCollisionFilterGroupMask(handle, -1, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            handle, -1, lateralFriction=body.friction, restitution=0.0, physicsClientId=self._client
        )
        return handle

    def _add_capsule(self, body: KinematicCapsule) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CAPSULE,
            radius=body.radius_m,
            height=body.height_m - 2 * body.radius_m,
            physicsClientId=self._client,
        )
        handle: int = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        pybullet.setCollisionFilterGroupMask(handle, -1, _OBSTACLE, _HULL, physicsClientId=self._client)
        pybullet.changeDynamics(handle, -1, lateralFriction=CAPSULE_FRICTION, physicsClientId=self._client)
        return handle

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # Setting poses and speeds back would keep the solver's warm-start
        # impulses (bullet3 #2442): a robot loaded anew has none.
        if self._robot is not None:
            pybullet.removeBody(self._robot, physicsClientId=self._client)
        self._robot = self._load_robot(position_w, quaternion)
        for index in range(len(self._kinematics)):
            self._move(index, kinematic_poses[index].tolist())
        self._poses[:] = kinematic_poses
        self._push = None

    def _load_robot(self, position_w: Sequence[float], quaternion: Sequence[float]) -> int:
        client, spec = self._client, self._spec.robot
        try:
            robot: int = pybullet.loadURDF(
                str(spec.urdf),
                basePosition=list(position_w),
                baseOrientation=list(quaternion),
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot load {spec.urdf}: {error}") from error
        joints = {
            pybullet.getJointInfo(robot, index, physicsClientId=client)[1].decode(): index
            for index in range(pybullet.getNumJoints(robot, physicsClientId=client))
        }
        missing = [name for name in spec.drive_joints if name not in joints]
        if missing:
            raise PhysicsError(
                f"{spec.urdf.name} has no joint {', '.join(missing)}; it has {', '.join(joints)}"
            )
        self._drive_joints = [joints[name] for name in spec.drive_joints]
        for link in range(-1, len(joints)):
            wheel = link in self._drive_joints
            pybullet.setCollisionFilterGroupMask(
                robot,
                link,
                _WHEEL if wheel else _HULL,
                _GROUND if wheel else _GROUND | _OBSTACLE,
                physicsClientId=client,
            )
            pybullet.changeDynamics(
                robot,
                link,
                lateralFriction=spec.wheel_friction if wheel else HULL_FRICTION,
                restitution=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
        # Apart from the above: beside one of these, PyBullet gives a link's friction to the base instead.
        pybullet.changeDynamics(
            robot,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        return robot

    def _move(self, index: int, pose: list[float]) -> None:
        x, y, z, yaw = pose
        pybullet.resetBasePositionAndOrientation(
            self._kinematics[index],
            (x, y, z + self._centre_heights[index]),
            (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            physicsClientId=self._client,
        )

    def step(
        self, count: int, drive_velocities: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        client, advance = self._client, pybullet.stepSimulation
        push, self._push = self._push, None
        pybullet.setJointMotorControlArray(
            self._robot,
            self._drive_joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=drive_velocities,
            forces=self._torques,
            physicsClientId=client,
        )
        near: list[tuple[int, list[float], list[float]]] = []
        if self._kinematics:
            (x, y, _), _ = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=client)
            for index, (old, new) in enumerate(
                zip(self._poses.tolist(), kinematic_poses.tolist(), strict=True)
            ):
                if abs(new[0] - x) < _NEAR_M and abs(new[1] - y) < _NEAR_M:
                    near.append((index, old, new))
                else:
                    self._move(index, new)
            self._poses[:] = kinematic_poses
        if not near and push is None:
            self.coast(count)
            return
        for part in range(1, count + 1):
            share = part / count
            for index, old, new in near:
                pose = [a + (b - a) * share for a, b in zip(old[:3], new[:3], strict=True)]
                self._move(index, [*pose, new[3]])
            if push is not None:
                self._apply(push)
            advance(physicsClientId=client)

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def _apply(self, force_w: Sequence[float]) -> None:
        # The engine forgets forces after each physics step.
        centre, _ = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        pybullet.applyExternalForce(
            self._robot, -1, force_w, centre, pybullet.WORLD_FRAME, physicsClientId=self._client
        )

    def coast(self, count: int) -> None:
        client, advance = self._client, pybullet.stepSimulation
        for _ in range(count):
            advance(physicsClientId=client)

    def body_state(self) -> tuple[float, ...]:
        position, quaternion = pybullet.getBasePositionAndOrientation(
            self._robot, physicsClientId=self._client
        )
        linear, angular = pybullet.getBaseVelocity(self._robot, physicsClientId=self._client)
        return (*position, *quaternion, *linear, *angular)

    def drive_state(self) -> tuple[float, ...]:
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        angles, speeds, _, torques = zip(*states, strict=True)
        return (*angles, *speeds, *torques)

    def touched(self) -> list[int]:
        # Wheels meet nothing but ground, so the hull's contacts are all that can be collisions.
        contacts = pybullet.getContactPoints(bodyA=self._robot, physicsClientId=self._client)
        numbers = self._numbers
        return [
            numbers[contact[2]] for contact in contacts if contact[2] in numbers and contact[8] < _TOUCH_M
        ]

    def close(self) -> None:
        if self._client is not None and pybullet.isConnected(self._client):
            pybullet.disconnect(self._client)
        self._client = None
