"""A robot in a PyBullet scene."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.errors import PhysicsError
from dune_rl.physics.base_frame import InertialFrame, Quadruple, Triple
from dune_rl.physics.bullet.tyres import TYRE_AXIS, tyre_link_name
from dune_rl.physics.bullet.urdf import RobotUrdfs, load_shared_urdfs, named_file
from dune_rl.physics.interface import Coupling, RobotBody
from dune_rl.physics.motors import Servos, held_targets, motor_power_w
from dune_rl.physics.stderr import suppress_stderr
from dune_rl.physics.varied_body import BodyVariation, scale_motors

with suppress_stderr():
    import pybullet

# Collision groups. WHEEL is for wheels that collide with the ground only: spheres, which are wider than their
# tyres. TYRE is for these, which collide with everything else. PyBullet lets two links collide if the group
# of one is in the mask of the other, either way.
GROUND, WHEEL, HULL, OBSTACLE, TYRE = 1, 2, 4, 8, 16

# Contact points closer than this count as contacts.
_CONTACT_DISTANCE_M = 1e-3
# What `getContactPoints` takes for any other body, and any link.
ANY_BODY, _ANY_LINK = -1, -2
# The force limit of a coupling is never reached. Its position error falls by the share _GEAR_ERP a second:
# above 10 it starts to oscillate. With 10 iterations Leo's rockers, on stones, have errors up to 1.2e-3 rad,
# with 20 half of that.
_GEAR_FORCE, _GEAR_ERP, GEAR_ITERATIONS = 1e4, 5.0, 20

# Position, quaternion, linear and angular velocity.
_BaseState = tuple[Triple, Quadruple, Triple, Triple]


class BulletRobot:
    """A `PhysicsRobot` in the PyBullet `client`.

    `body_numbers` maps PyBullet's handles of the bodies that are not ground to
    body numbers; the scene updates it. `hull_mask` has the collision groups
    that the hull collides with.
    """

    def __init__(
        self,
        client: int,
        spec: RobotBody,
        timestep_s: float,
        body_numbers: Mapping[int, int],
        hull_mask: int,
        *,
        measures_work: bool,
    ) -> None:
        self._client, self._spec, self._timestep_s = client, spec, timestep_s
        self._body_numbers, self._hull_mask = body_numbers, hull_mask
        self._robot: int | None = None
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._force: Sequence[float] | None = None
        self._joints: dict[str, int] = {}
        self._drive_joints: list[int] = []
        self._wheel_contacts: list[tuple[float, ...]] = []
        self._motors = spec.motors
        # Ideal motors take a command once a control step; others need the joint states in every physics step.
        self.has_ideal_motors = all(motor.is_ideal for motor in self._motors)
        self._has_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in self._motors)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        self._commands: Sequence[float] = spec.rest_commands()
        self._servos = Servos(self._motors, timestep_s)
        self._next_variation: BodyVariation | None = None
        self._variation: BodyVariation | None = None
        self._urdfs = load_shared_urdfs(spec)
        self._frame: InertialFrame | None = None
        self.measures_work = measures_work and bool(self._motors)
        self._work = 0.0
        self._speeds: Sequence[float] = ()
        self._base_state: _BaseState | None = None
        self._touched: set[int] = set()
        # See `GatedRobot`; the position is that of the base's centre of mass. Infinite until it is measured.
        self.reach_m = math.inf
        self.base_mass_kg = 0.0

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = scale_motors(self._spec.motors, variation.motor_strength)
        self._servos = Servos(self._motors, self._timestep_s)
        self._torques = [motor.max_torque_nm for motor in self._motors]
        self._next_variation = None if variation.keeps_masses else variation
        # The centre of mass, which the reach is about, may move.
        self.reach_m = math.inf

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._pose = (position_w, quaternion)

    def remove(self) -> None:
        """Remove the robot from the scene."""
        if self._robot is not None:
            pybullet.removeBody(self._robot, physicsClientId=self._client)
        self._robot = None

    def load(self) -> int:
        """Load the robot at its start pose, without tyres, and return PyBullet's handle."""
        if self._next_variation is not self._variation:
            self._variation = variation = self._next_variation
            shared = variation is None
            self._urdfs = load_shared_urdfs(self._spec) if shared else RobotUrdfs(self._spec, variation)
        self._robot = self._load_robot(frozenset())
        self._commands = self._spec.rest_commands()
        self._servos.reset()
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)
        self._force = None
        self._wheel_contacts = [() for _ in self._ground_links]
        self._base_state = None
        self._touched.clear()
        if self.reach_m == math.inf:
            self.reach_m = self._measure_reach_m(self._robot)
        return self._robot

    def reload(self, tyres: frozenset[int]) -> int:
        """Replace the robot by one with other tyres, in the same state, and return its handle.

        PyBullet can neither add links to a loaded body nor remove them.
        """
        client, old = self._client, self._robot
        position, quaternion = pybullet.getBasePositionAndOrientation(old, physicsClientId=client)
        linear, angular = pybullet.getBaseVelocity(old, physicsClientId=client)
        joints = pybullet.getJointStates(old, self._movable, physicsClientId=client)
        self.remove()
        self._robot = robot = self._load_robot(tyres)
        pybullet.resetBasePositionAndOrientation(robot, position, quaternion, physicsClientId=client)
        pybullet.resetBaseVelocity(robot, linear, angular, physicsClientId=client)
        for joint, (angle, speed, _, _) in zip(self._movable, joints, strict=True):
            pybullet.resetJointState(robot, joint, angle, speed, physicsClientId=client)
        for wheel, row in enumerate(self._wheel_contacts):
            self._apply_wheel_contact(wheel, row)
        return robot

    def release(self) -> None:
        """Drop the handle after the client was disconnected."""
        self._robot = None

    def _load_robot(self, tyres: frozenset[int]) -> int:
        # PyBullet cannot change masses or links of a loaded body, and loads a URDF only from a file.
        with named_file(self._urdfs.text(tyres)) as name:
            robot = self._load_file(name, has_tyres=bool(tyres))
        self._set_up(robot)
        return robot

    def _load_file(self, name: str, *, has_tyres: bool) -> int:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        if has_tyres:
            # Round, not prisms with 32 sides.
            flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER
        position_w, quaternion = self._pose
        try:
            robot: int = pybullet.loadURDF(
                name,
                basePosition=list(position_w),
                baseOrientation=list(quaternion),
                flags=flags,
                physicsClientId=self._client,
            )
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot load {self._spec.urdf}: {error}") from error
        return robot

    def _set_up(self, robot: int) -> None:
        """Set the contact parameters, collision filters and joints of a loaded robot."""
        client = self._client
        self._name_joints(robot)
        for link in range(-1, len(self._links) - 1):
            self._set_up_link(robot, link)
        # In a call of its own: together with one of these, PyBullet applies a link's friction to the base.
        pybullet.changeDynamics(
            robot,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        self._set_up_joints(robot)
        info = pybullet.getDynamicsInfo(robot, -1, physicsClientId=client)
        frame = InertialFrame(info[3], info[4])
        self._frame = None if frame.is_identity else frame
        self.base_mass_kg = info[0]

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
        error = spec.describe_missing_names(self._joints, self._links)
        if error:
            raise PhysicsError(error)
        self._drive_joints = [self._joints[name] for name in spec.drive_joints]
        self._ground_links = [self._links[name] for name in spec.ground_links]
        tyre_names = [tyre_link_name(tyre) for tyre in spec.tyres]
        self._tyre_links = [self._links[name] for name in tyre_names if name in self._links]

    def _set_up_link(self, robot: int, link: int) -> None:
        spec = self._spec
        axle: Sequence[float] | None = None
        if link in self._tyre_links:
            # Other robots have tyres, too.
            mask = self._hull_mask & ~GROUND | (TYRE if self._hull_mask & HULL else 0)
            group, friction, axle = TYRE, spec.ground_friction, TYRE_AXIS
        elif link in self._ground_links:
            collides = spec.ground_links_meet_obstacles
            group, mask = (HULL, self._hull_mask) if collides else (WHEEL, GROUND)
            friction, axle = spec.ground_friction, self._axes.get(link)
        else:
            group, mask, friction = HULL, self._hull_mask, spec.hull_friction
        pybullet.setCollisionFilterGroupMask(robot, link, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            robot,
            link,
            lateralFriction=friction,
            restitution=0.0,
            jointDamping=0.0,
            physicsClientId=self._client,
        )
        if axle is not None and spec.sideways_friction_share != 1.0:
            less = 1.0 - spec.sideways_friction_share
            pybullet.changeDynamics(
                robot,
                link,
                anisotropicFriction=[1.0 - less * abs(part) for part in axle],
                physicsClientId=self._client,
            )

    def _set_up_joints(self, robot: int) -> None:
        """Disable PyBullet's default motors of passive joints, set start angles, and add couplings."""
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
            self._add_coupling(robot, coupling)

    def _add_coupling(self, robot: int, coupling: Coupling) -> None:
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
        # Bullet's constraint: leader speed + gearRatio * follower speed = 0.
        ratio = -1.0 / coupling.ratio
        pybullet.changeConstraint(
            gear, gearRatio=ratio, maxForce=_GEAR_FORCE, erp=_GEAR_ERP, physicsClientId=self._client
        )

    def set_command(self, commands: Sequence[float]) -> None:
        self._commands = commands

    def _measure_reach_m(self, robot: int) -> float:
        """Upper bound of the distance of any point of the robot from the base's centre of mass.

        Each link adds the distance of its joint from its parent's, whatever the angles of the joints are.
        """
        client = self._client
        start, _ = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
        joints, distances = {-1: start}, {-1: 0.0}
        reach = _farthest_m(start, *pybullet.getAABB(robot, -1, physicsClientId=client))
        for link in range(pybullet.getNumJoints(robot, physicsClientId=client)):
            info = pybullet.getJointInfo(robot, link, physicsClientId=client)
            position = pybullet.getLinkState(robot, link, physicsClientId=client)[4]
            distance = distances[info[16]] + math.dist(position, joints[info[16]])
            if info[2] == pybullet.JOINT_PRISMATIC:
                low, high = info[8:10]
                distance += max(abs(low), abs(high)) if low <= high else math.inf
            joints[link], distances[link] = position, distance
            box = pybullet.getAABB(robot, link, physicsClientId=client)
            reach = max(reach, distance + _farthest_m(position, *box))
        tyres = (distances[self._links[tyre.link]] + tyre.reach_m for tyre in self._spec.tyres)
        return max([reach, *tyres])

    def planar_motion(self) -> tuple[float, float, float]:
        """See `GatedRobot`."""
        position, _, velocity, _ = self._read_base()
        return position[0], position[1], math.hypot(*velocity)

    def velocity_xy(self) -> tuple[float, float]:
        """Horizontal velocity of the base [m/s]."""
        velocity = self._read_base()[2]
        return velocity[0], velocity[1]

    def begin_step(self, count: int) -> None:
        """Pass the commands to the motors for the next `count` physics steps."""
        self._touched.clear()
        if self.has_ideal_motors:
            if self._has_curves:
                robot, joints, client = self._robot, self._drive_joints, self._client
                states = pybullet.getJointStates(robot, joints, physicsClientId=client)
                speeds = [state[1] for state in states]
                self._set_motors(*held_targets(self._motors, self._commands, speeds))
            else:
                self._set_motors(self._commands, self._torques)
        else:
            self._servos.set_commands(self._commands, count)

    def apply_force(self, force_w: Sequence[float]) -> None:
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force set by `apply_force` since the last call, which is removed; None if there is none."""
        force, self._force = self._force, None
        return force

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N] in the next physics step."""
        # The engine clears forces after each physics step.
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
        # PyBullet ignores negative values.
        unchanged = [-1.0] * len(self._ground_links)
        rows = zip(friction, restitution, stiffness or unchanged, damping or unchanged, strict=True)
        for wheel, row in enumerate(rows):
            if row != self._wheel_contacts[wheel]:
                self._wheel_contacts[wheel] = row
                self._apply_wheel_contact(wheel, row)

    def _apply_wheel_contact(self, wheel: int, row: Sequence[float]) -> None:
        """Set friction, restitution, stiffness and damping of a ground link, if `row` is not empty."""
        if row:
            pybullet.changeDynamics(
                self._robot,
                self._ground_links[wheel],
                lateralFriction=row[0],
                restitution=row[1],
                contactStiffness=row[2],
                contactDamping=row[3],
                physicsClientId=self._client,
            )

    def add_work(self) -> None:
        """Add the motors' work in the last physics step to `work_j`."""
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        _, speeds, _, torques = zip(*states, strict=True)
        # The joint speed changes linearly over a step under a constant torque.
        means = [(before + after) / 2 for before, after in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += motor_power_w(self._motors, means, torques) * self._timestep_s

    def work_j(self) -> float:
        work, self._work = self._work, 0.0
        return work

    def _set_motors(self, speeds: Sequence[float], torques: Sequence[float]) -> None:
        pybullet.setJointMotorControlArray(
            self._robot,
            self._drive_joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=speeds,
            forces=torques,
            physicsClientId=self._client,
        )

    def command_motors(self) -> None:
        """Set target speeds and torque limits of the motors for the next physics step."""
        states = pybullet.getJointStates(self._robot, self._drive_joints, physicsClientId=self._client)
        angles, speeds, _, _ = zip(*states, strict=True)
        self._set_motors(*self._servos.targets(angles, speeds))

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._base_state = None

    def _read_base(self) -> _BaseState:
        """Pose and velocities of the base's inertial frame, read once between physics steps."""
        state = self._base_state
        if state is None:
            robot, client = self._robot, self._client
            self._base_state = state = (
                *pybullet.getBasePositionAndOrientation(robot, client),
                *pybullet.getBaseVelocity(robot, client),
            )
        return state

    def body_state(self) -> tuple[float, ...]:
        position, quaternion, linear, angular = self._read_base()
        if self._frame is not None:
            position, quaternion, linear = self._frame.link_state(position, quaternion, linear, angular)
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

    def record_contacts(self, handles: Sequence[int]) -> Sequence[tuple[Any, ...]]:
        """Add what the robot touched in the last physics step to `contacts`; returns all contact points with
        bodies that are not ground.

        `handles` are those of the bodies that it can have touched, or ANY_BODY.
        """
        numbers, found = self._body_numbers, []
        for handle in handles:
            # Names of arguments would take PyBullet a fifth of the call.
            points = pybullet.getContactPoints(self._robot, handle, _ANY_LINK, _ANY_LINK, self._client)
            for contact in points:
                # Ground has no number: what remains is collisions.
                if contact[2] in numbers:
                    found.append(contact)
                    if contact[8] < _CONTACT_DISTANCE_M:
                        self._touched.add(numbers[contact[2]])
        return found

    def contacts(self) -> list[int]:
        return sorted(self._touched)


def _farthest_m(point: Triple, low: Triple, high: Triple) -> float:
    """Distance of the corner of a box that is farthest from a point."""
    return math.hypot(*(max(abs(a - p), abs(b - p)) for p, a, b in zip(point, low, high, strict=True)))
