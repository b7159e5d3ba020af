"""A robot in a PyBullet scene."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from dune_rl.errors import PhysicsError
from dune_rl.physics.base_frame import InertialFrame
from dune_rl.physics.interface import Coupling, RobotBody
from dune_rl.physics.motors import Servos, work_w
from dune_rl.physics.quiet import silent_stderr
from dune_rl.physics.varied_body import BodyVariation, motors_at, varied_urdf

with silent_stderr():
    import pybullet

# Collision groups. Spheres stand in for wheels; they are wider than the tyres
# they stand for, so they roll on the ground and leave obstacles to the hull.
GROUND, WHEEL, HULL, OBSTACLE = 1, 2, 4, 8

_TOUCH_M = 1e-3
# A coupling gives what it takes. What it is off by falls by this share a second: more than 10 and it
# swings up. With 10 iterations Leo's rockers, on stones, are up to 1.2e-3 rad off, with 20 half of that.
_GEAR_FORCE, _GEAR_ERP, GEAR_ITERATIONS = 1e4, 5.0, 20


class BulletRobot:
    """A `PhysicsRobot` of the PyBullet `client`, loaded by `place`.

    `numbers` are those of the bodies that it may touch, by PyBullet's handles
    of them, which may change. `hull_meets` are the collision groups that its
    hull meets.
    """

    def __init__(
        self,
        client: int,
        spec: RobotBody,
        timestep_s: float,
        numbers: Mapping[int, int],
        hull_meets: int,
        *,
        measures_work: bool,
    ) -> None:
        self._client, self._spec, self._timestep_s = client, spec, timestep_s
        self._numbers, self._hull_meets = numbers, hull_meets
        self._robot: int | None = None
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._push: Sequence[float] | None = None
        self._joints: dict[str, int] = {}
        self._drive_joints: list[int] = []
        self._contacts: list[tuple[float, ...]] = []
        self._motors = spec.motors
        # Most wheels take a command as it is, once a control step; others need a look in every physics step.
        self.plain = all(motor.is_plain for motor in self._motors)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        self._commands: Sequence[float] = spec.rest_commands()
        self._servos = Servos(self._motors, timestep_s)
        self._varied_urdf: str | None = None
        self._frame: InertialFrame | None = None
        self.measures_work = measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = motors_at(self._spec.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._timestep_s)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        as_is = variation.is_of_the_urdf
        self._varied_urdf = None if as_is else varied_urdf(self._spec.urdf, variation)

    def stand(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._pose = (position_w, quaternion)

    def remove(self) -> None:
        """Take it out of the scene."""
        if self._robot is not None:
            pybullet.removeBody(self._robot, physicsClientId=self._client)
        self._robot = None

    def place(self) -> int:
        """Load it where it is to stand; PyBullet's handle of it."""
        if self._varied_urdf is None:
            self._robot = self._load_robot(self._spec.urdf, *self._pose)
        else:
            # PyBullet moves no centre of mass in place, and loads a URDF from files alone.
            handle, name = tempfile.mkstemp(prefix="dune_rl_", suffix=".urdf")
            try:
                with open(handle, "w", encoding="utf-8") as file:
                    file.write(self._varied_urdf)
                self._robot = self._load_robot(Path(name), *self._pose)
            finally:
                Path(name).unlink()
        self._commands = self._spec.rest_commands()
        self._servos.rest()
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        self._push = None
        self._contacts = [() for _ in self._ground_links]
        return self._robot

    def forget(self) -> None:
        """The engine is gone, and with it the robot."""
        self._robot = None

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
            raise PhysicsError(f"PyBullet cannot load {self._spec.urdf}: {error}") from error
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
        client, spec = self._client, self._spec
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
        spec = self._spec
        if link in self._ground_links:
            meets = spec.ground_links_meet_obstacles
            group, mask = (HULL, self._hull_meets) if meets else (WHEEL, GROUND)
            friction = spec.ground_friction
        else:
            group, mask, friction = HULL, self._hull_meets, spec.hull_friction
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
        client, spec = self._client, self._spec
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
        # Bullet keeps the leader's speed and so many times the follower's at a sum of 0.
        ratio = -1.0 / coupling.ratio
        pybullet.changeConstraint(
            gear, gearRatio=ratio, maxForce=_GEAR_FORCE, erp=_GEAR_ERP, physicsClientId=self._client
        )

    def drive(self, commands: Sequence[float]) -> None:
        self._commands = commands

    def xy(self) -> tuple[float, float]:
        """Where its centre of mass is, seen from above [m]."""
        (x, y, _), _ = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        return x, y

    def begin(self, count: int) -> None:
        """Have the motors take their commands for the next `count` physics steps."""
        if self.plain:
            self._hold(self._commands, self._torques)
        else:
            self._servos.command(self._commands, count)

    def push(self, force_w: Sequence[float]) -> None:
        self._push = force_w if any(force_w) else None

    def pushed(self) -> Sequence[float] | None:
        """The force set by `push` since this was asked last; None where there is none."""
        push, self._push = self._push, None
        return push

    def apply(self, force_w: Sequence[float]) -> None:
        """Have a force (3) [N] act in the next physics step."""
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

    def count_work(self) -> None:
        """Sum up the motors' work of the physics step that was made."""
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        _, speeds, _, torques = zip(*states, strict=True)
        # A torque acts from the speed before a step to the one after it.
        means = [(one + other) / 2 for one, other in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += work_w(self._motors, means, torques) * self._timestep_s

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

    def act(self) -> None:
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
        if self._robot is None:
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
