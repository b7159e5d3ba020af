"""The PyBullet backend."""

import math
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.base_frame import InertialFrame
from dune_rl.physics.interface import CAPSULE_FRICTION, Coupling, KinematicCapsule, SceneSpec, StaticBody
from dune_rl.physics.mesh_pieces import mesh_pieces
from dune_rl.physics.motors import Servos, work_w
from dune_rl.physics.quiet import silent_stderr
from dune_rl.physics.varied_body import BodyVariation, motors_at, varied_urdf

with silent_stderr():
    import pybullet

# Collision groups. Spheres stand in for wheels; they are wider than the tyres
# they stand for, so they roll on the ground and leave obstacles to the hull.
_GROUND, _WHEEL, _HULL, _OBSTACLE = 1, 2, 4, 8

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0
_TOUCH_M = 1e-3
# A coupling gives what it takes. What it is off by falls by this share a second: more than 10 and it
# swings up. With 10 iterations Leo's rockers, on stones, are up to 1.2e-3 rad off, with 20 half of that.
_GEAR_FORCE, _GEAR_ERP, _GEAR_ITERATIONS = 1e4, 5.0, 20

# PyBullet's wheel takes no more vertices and indices in a mesh (B3_MAX_NUM_VERTICES, B3_MAX_NUM_INDICES).
_MOST_VERTICES, _MOST_FACES = 131_072, 524_288 // 3


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
        # A client holds some 30 MB, which PyBullet keeps until it is told to end it.
        self._end = weakref.finalize(self, _disconnect, self._client)
        self._end.atexit = False
        iterations = spec.solver_iterations
        if spec.robot.couplings:
            iterations = max(iterations, _GEAR_ITERATIONS)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=spec.timestep_s,
            numSolverIterations=iterations,
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
            for vertices, faces in mesh_pieces(body.vertices, body.faces, _MOST_VERTICES, _MOST_FACES):
                handle = self._add_static(replace(body, vertices=vertices, faces=faces))
                if not body.ground:
                    self._numbers[handle] = number
        self._kinematics = [self._add_capsule(body) for body in spec.kinematics]
        self._centre_heights = [body.height_m / 2 for body in spec.kinematics]
        for number, handle in enumerate(self._kinematics, start=len(spec.statics)):
            self._numbers[handle] = number
        self._poses = np.zeros((len(self._kinematics), 4))
        self._robot: int | None = None
        self._push: Sequence[float] | None = None
        self._joints: dict[str, int] = {}
        self._drive_joints: list[int] = []
        self._contacts: list[tuple[float, ...]] = []
        self._varied_urdf: str | None = None
        self._motors = spec.robot.motors
        # Most wheels take a command as it is, once a control step; others need a look in every physics step.
        self._plain = all(motor.is_plain for motor in self._motors)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        self._servos = Servos(self._motors, spec.timestep_s)
        self._frame: InertialFrame | None = None
        self._measures_work = spec.measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()

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
            handle,
            -1,
            lateralFriction=body.friction,
            restitution=body.restitution,
            physicsClientId=self._client,
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

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = motors_at(self._spec.robot.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._spec.timestep_s)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        as_is = variation.is_of_the_urdf
        self._varied_urdf = None if as_is else varied_urdf(self._spec.robot.urdf, variation)

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # Setting poses and speeds back would keep the solver's warm-start
        # impulses (bullet3 #2442): a robot loaded anew has none.
        if self._robot is not None:
            pybullet.removeBody(self._robot, physicsClientId=self._client)
        if self._varied_urdf is None:
            self._robot = self._load_robot(self._spec.robot.urdf, position_w, quaternion)
        else:
            # PyBullet moves no centre of mass in place, and loads a URDF from files alone.
            handle, name = tempfile.mkstemp(prefix="dune_rl_", suffix=".urdf")
            try:
                with open(handle, "w", encoding="utf-8") as file:
                    file.write(self._varied_urdf)
                self._robot = self._load_robot(Path(name), position_w, quaternion)
            finally:
                Path(name).unlink()
        self._servos.rest()
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        for index in range(len(self._kinematics)):
            self._move(index, kinematic_poses[index].tolist())
        self._poses[:] = kinematic_poses
        self._push = None
        self._contacts = [() for _ in self._ground_links]

    def _load_robot(self, urdf: Path, position_w: Sequence[float], quaternion: Sequence[float]) -> int:
        client = self._client
        try:
            robot: int = pybullet.loadURDF(
                str(urdf),
                basePosition=list(position_w),
                baseOrientation=list(quaternion),
                # Looks are drawn elsewhere: to read their meshes at every start would cost milliseconds.
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_IGNORE_VISUAL_SHAPES,
                physicsClientId=client,
            )
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot load {self._spec.robot.urdf}: {error}") from error
        self._name_joints(robot)
        for link in range(-1, len(self._links) - 1):
            self._set_up_link(robot, link)
        # Apart from the above: beside one of these, PyBullet gives a link's friction to the base instead.
        pybullet.changeDynamics(
            robot,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        self._set_up_joints(robot)
        told = pybullet.getDynamicsInfo(robot, -1, physicsClientId=client)
        frame = InertialFrame(told[3], told[4])
        self._frame = None if frame.is_the_links else frame
        return robot

    def _name_joints(self, robot: int) -> None:
        client, spec = self._client, self._spec.robot
        infos = [
            pybullet.getJointInfo(robot, index, physicsClientId=client)
            for index in range(pybullet.getNumJoints(robot, physicsClientId=client))
        ]
        base = pybullet.getBodyInfo(robot, physicsClientId=client)[0].decode()
        self._joints = {info[1].decode(): info[0] for info in infos}
        self._links = {base: -1} | {info[12].decode(): info[0] for info in infos}
        self._movable = [info[0] for info in infos if info[2] != pybullet.JOINT_FIXED]
        self._axes = {info[0]: info[13] for info in infos}
        fault = spec.missing_from(self._joints, self._links)
        if fault:
            raise PhysicsError(fault)
        self._drive_joints = [self._joints[name] for name in spec.drive_joints]
        self._ground_links = [self._links[name] for name in spec.ground_links]

    def _set_up_link(self, robot: int, link: int) -> None:
        spec = self._spec.robot
        if link in self._ground_links:
            meets = spec.ground_links_meet_obstacles
            group, mask = (_HULL, _GROUND | _OBSTACLE) if meets else (_WHEEL, _GROUND)
            friction = spec.ground_friction
        else:
            group, mask, friction = _HULL, _GROUND | _OBSTACLE, spec.hull_friction
        pybullet.setCollisionFilterGroupMask(robot, link, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            robot,
            link,
            lateralFriction=friction,
            restitution=0.0,
            jointDamping=0.0,
            physicsClientId=self._client,
        )
        if link in self._ground_links and spec.sideways_friction_share != 1.0:
            less = 1.0 - spec.sideways_friction_share
            pybullet.changeDynamics(
                robot,
                link,
                anisotropicFriction=[1.0 - less * abs(part) for part in self._axes[link]],
                physicsClientId=self._client,
            )

    def _set_up_joints(self, robot: int) -> None:
        """Free the joints that PyBullet holds by motors of its own, and couple those that are."""
        client, spec = self._client, self._spec.robot
        friction = {self._joints[joint.joint]: joint.friction_nm for joint in spec.passive}
        for joint in self._movable:
            if joint not in self._drive_joints:
                pybullet.setJointMotorControl2(
                    robot,
                    joint,
                    pybullet.VELOCITY_CONTROL,
                    targetVelocity=0.0,
                    force=friction.get(joint, 0.0),
                    physicsClientId=client,
                )
        for passive in spec.passive:
            pybullet.changeDynamics(
                robot,
                self._joints[passive.joint],
                jointDamping=passive.damping_nms_per_rad,
                physicsClientId=client,
            )
        for motor in spec.motors:
            if motor.rest_rad:
                pybullet.resetJointState(
                    robot, self._joints[motor.joint], motor.rest_rad, physicsClientId=client
                )
        for coupling in spec.couplings:
            self._couple(robot, coupling)

    def _couple(self, robot: int, coupling: Coupling) -> None:
        gear = pybullet.createConstraint(
            robot,
            self._joints[coupling.leader],
            robot,
            self._joints[coupling.follower],
            pybullet.JOINT_GEAR,
            (0.0, 1.0, 0.0),
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            physicsClientId=self._client,
        )
        # Bullet's ratio is that of what cancels, hence the sign.
        pybullet.changeConstraint(
            gear, gearRatio=-coupling.ratio, maxForce=_GEAR_FORCE, erp=_GEAR_ERP, physicsClientId=self._client
        )

    def _move(self, index: int, pose: list[float]) -> None:
        x, y, z, yaw = pose
        pybullet.resetBasePositionAndOrientation(
            self._kinematics[index],
            (x, y, z + self._centre_heights[index]),
            (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            physicsClientId=self._client,
        )

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        client = self._client
        push, self._push = self._push, None
        if self._plain:
            self._hold(commands, self._torques)
        else:
            self._servos.command(commands, count)
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
            self.coast(1)

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def _apply(self, force_w: Sequence[float]) -> None:
        # The engine forgets forces after each physics step.
        centre, _ = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        pybullet.applyExternalForce(
            self._robot, -1, force_w, centre, pybullet.WORLD_FRAME, physicsClientId=self._client
        )

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        # Negative ones are left as they are.
        rigid = [-1.0] * len(self._ground_links)
        rows = zip(friction, restitution, stiffness or rigid, damping or rigid, strict=True)
        for wheel, row in enumerate(rows):
            if row == self._contacts[wheel]:
                continue
            self._contacts[wheel] = row
            pybullet.changeDynamics(
                self._robot,
                self._ground_links[wheel],
                lateralFriction=row[0],
                restitution=row[1],
                contactStiffness=row[2],
                contactDamping=row[3],
                physicsClientId=self._client,
            )

    def coast(self, count: int) -> None:
        client, advance = self._client, pybullet.stepSimulation
        for _ in range(count):
            if not self._plain:
                self._drive()
            advance(physicsClientId=client)
            if self._measures_work:
                self._count_work()

    def _count_work(self) -> None:
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        _, speeds, _, torques = zip(*states, strict=True)
        # A torque acts from the speed before a step to the one after it.
        means = [(one + other) / 2 for one, other in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += work_w(self._motors, means, torques) * self._spec.timestep_s

    def work_j(self) -> float:
        done, self._work = self._work, 0.0
        return done

    def _hold(self, speeds: Sequence[float], torques: Sequence[float]) -> None:
        pybullet.setJointMotorControlArray(
            self._robot,
            self._drive_joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=speeds,
            forces=torques,
            physicsClientId=self._client,
        )

    def _drive(self) -> None:
        """Have the motors do what they can toward their commands in the next physics step."""
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        angles, speeds, _, _ = zip(*states, strict=True)
        self._hold(*self._servos.next(angles, speeds))

    def body_state(self) -> tuple[float, ...]:
        position, quaternion = pybullet.getBasePositionAndOrientation(
            self._robot, physicsClientId=self._client
        )
        linear, angular = pybullet.getBaseVelocity(self._robot, physicsClientId=self._client)
        if self._frame is not None:
            position, quaternion, linear = self._frame.of_the_link(position, quaternion, linear, angular)
        return (*position, *quaternion, *linear, *angular)

    def drive_state(self) -> tuple[float, ...]:
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        angles, speeds, _, torques = zip(*states, strict=True)
        return (*angles, *speeds, *torques)

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        if self._robot is None or self._client is None:
            return (0.0,) * len(joints)
        indices = [self._joints[name] for name in joints]
        states = pybullet.getJointStates(self._robot, indices, physicsClientId=self._client)
        return tuple(state[0] for state in states)

    def touched(self) -> list[int]:
        # The ground has no number, so that what is left is collisions.
        contacts = pybullet.getContactPoints(bodyA=self._robot, physicsClientId=self._client)
        numbers = self._numbers
        return [
            numbers[contact[2]] for contact in contacts if contact[2] in numbers and contact[8] < _TOUCH_M
        ]

    def close(self) -> None:
        self._end()
        self._client = None


def _disconnect(client: int) -> None:
    if pybullet.isConnected(client):
        pybullet.disconnect(client)
