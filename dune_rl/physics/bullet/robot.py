"""A robot in a PyBullet scene: its loading, the state of its base link, and its contacts."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.bullet.client import pybullet
from dune_rl.physics.bullet.loading import (
    LoadedBody,
    RobotUrdfs,
    load_shared_urdfs,
    named_file,
    set_up_joints,
    set_up_links,
)
from dune_rl.physics.bullet.motors import BulletMotors
from dune_rl.physics.engine_robot import EngineRobot
from dune_rl.physics.robot_body import AS_DESCRIBED, BodyVariation, RobotBody

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]

# Contact points closer than this count as contacts.
_CONTACT_DISTANCE_M = 1e-3
# What `getContactPoints` takes for any other body, and any link.
ANY_BODY, _ANY_LINK = -1, -2


class BulletRobot(EngineRobot):
    """A `PhysicsRobot` in the PyBullet `client`.

    `body_numbers` maps PyBullet's handles of the bodies that are not ground to body numbers; the scene
    updates it. `hull_mask` has the collision groups that the hull collides with. `motors` are for the scene,
    which calls them in every physics step; they stay the same object over `load` and `reload`.

    PyBullet can neither add links to a loaded body nor remove them, and its masses stay as loaded: for each
    such change the robot is loaded anew.
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
        super().__init__(spec)
        self._body = LoadedBody(client, spec)
        self._numbers, self._hull_mask = body_numbers, hull_mask
        self._urdfs = load_shared_urdfs(spec)
        self._variation = self._next_variation = AS_DESCRIBED
        self.motors = BulletMotors(self._body, spec, timestep_s, measures_work=measures_work)
        self.drive_state, self.joint_angles = self.motors.joint_states, self._body.joint_angles
        self.remove = self._body.remove
        # Pose, linear and angular velocity of the base's inertial frame, read once between physics steps.
        self._state: tuple[Triple, Quadruple, Triple, Triple] | None = None
        # Pose of that frame in the link's, (3) [m] and xyzw (4); None if both are the same.
        self._inertial_frame: tuple[Triple, Quadruple] | None = None
        # Friction, restitution, stiffness and damping of each wheel; empty as long as they are those loaded.
        self._wheel_contacts: list[tuple[float, ...]] = []
        # See `GatedRobot`; the position is that of the base's centre of mass. Infinite until it is measured.
        self.reach_m = math.inf
        self.base_mass_kg = 0.0

    def set_body(self, variation: BodyVariation) -> None:
        self.motors.set_strength(variation.motor_strength)
        self._next_variation = AS_DESCRIBED if variation.keeps_masses else variation
        # The centre of mass, which the reach is about, may move.
        self.reach_m = math.inf

    def load(self) -> int:
        """Load the robot at its start pose, without tyres, and return PyBullet's handle."""
        if self._next_variation is not self._variation:
            self._variation = variation = self._next_variation
            shared = variation is AS_DESCRIBED
            self._urdfs = load_shared_urdfs(self.spec) if shared else RobotUrdfs(self.spec, variation)
        handle = self._load(frozenset())
        self.forget_episode()
        self._state = None
        self.motors.reset()
        self._wheel_contacts = [() for _ in self._body.ground_links]
        if self.reach_m == math.inf:
            self.reach_m = measure_reach_m(self._body, self.spec)
        return handle

    def reload(self, tyres: frozenset[int]) -> int:
        """Replace the robot by one with the tyres of these indices, in the same state; return its handle."""
        body, client = self._body, self._body.client
        old = body.handle
        position, quaternion = pybullet.getBasePositionAndOrientation(old, physicsClientId=client)
        linear, angular = pybullet.getBaseVelocity(old, physicsClientId=client)
        joints = pybullet.getJointStates(old, body.movable, physicsClientId=client)
        body.remove()
        robot = self._load(tyres)
        pybullet.resetBasePositionAndOrientation(robot, position, quaternion, physicsClientId=client)
        pybullet.resetBaseVelocity(robot, linear, angular, physicsClientId=client)
        for joint, (angle, speed, _, _) in zip(body.movable, joints, strict=True):
            pybullet.resetJointState(robot, joint, angle, speed, physicsClientId=client)
        for wheel, row in enumerate(self._wheel_contacts):
            if row:
                self._set_wheel_contact(wheel, row)
        return robot

    def _load(self, tyres: frozenset[int]) -> int:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        if tyres:
            # Round, not prisms with 32 sides.
            flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER
        position_w, quaternion = map(list, self.start_pose)
        client = self._body.client
        # PyBullet loads a URDF only from a file.
        with named_file(self._urdfs.text(tyres)) as name:
            try:
                robot: int = pybullet.loadURDF(
                    name, position_w, quaternion, flags=flags, physicsClientId=client
                )
            except pybullet.error as error:
                raise PhysicsError(f"PyBullet cannot load {self.spec.urdf}: {error}") from error
        self._body.take(robot)
        set_up_links(self._body, self.spec, self._hull_mask)
        set_up_joints(self._body, self.spec)
        # Mass and centre of the base may differ after each load.
        info = pybullet.getDynamicsInfo(robot, -1, physicsClientId=client)
        self.base_mass_kg, origin, turn = info[0], info[3], info[4]
        self._inertial_frame = (origin, turn) if any(origin) or any(turn[:3]) else None
        return robot

    def release(self) -> None:
        """Drop the handle after the client was disconnected."""
        self._body.handle = None

    def begin_step(self, count: int) -> None:
        """Forget what was touched, and pass the commands to the motors for `count` physics steps."""
        self.touched.clear()
        self.motors.begin_step(self.commands, count)

    def end_step(self) -> None:
        """Read the state after a control step at once, while the processor still has it in its cache."""
        self.mark_moved()
        self._read()
        self.motors.read_speeds()

    def mark_moved(self) -> None:
        """Drop what was read before a physics step."""
        self._state = None
        self.motors.mark_moved()

    def _read(self) -> tuple[Triple, Quadruple, Triple, Triple]:
        state = self._state
        if state is None:
            robot, client = self._body.handle, self._body.client
            self._state = state = (
                *pybullet.getBasePositionAndOrientation(robot, client),
                *pybullet.getBaseVelocity(robot, client),
            )
        return state

    def body_state(self) -> tuple[float, ...]:
        centre, quaternion, linear, angular = self._read()
        if self._inertial_frame is None:
            return (*centre, *quaternion, *linear, *angular)
        origin_b, (qx, qy, qz, qw) = self._inertial_frame
        link = _multiply(quaternion, (-qx, -qy, -qz, qw))
        ax, ay, az = _rotate(link, origin_b)
        (x, y, z), (vx, vy, vz), (ox, oy, oz) = centre, linear, angular
        return (
            *(x - ax, y - ay, z - az),
            *link,
            *(vx - (oy * az - oz * ay), vy - (oz * ax - ox * az), vz - (ox * ay - oy * ax)),
            *angular,
        )

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the centre of mass, and speed [m/s] in all three directions."""
        position, _, velocity, _ = self._read()
        return position[0], position[1], math.hypot(*velocity)

    def velocity_xy(self) -> tuple[float, float]:
        """Horizontal velocity of the centre of mass [m/s] after the last physics step."""
        velocity = pybullet.getBaseVelocity(self._body.handle, self._body.client)[0]
        return velocity[0], velocity[1]

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N], world frame, to the centre of mass in the next physics step."""
        # The engine clears forces after each physics step.
        robot, client = self._body.handle, self._body.client
        centre, _ = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
        pybullet.applyExternalForce(robot, -1, force_w, centre, pybullet.WORLD_FRAME, physicsClientId=client)

    def record_contacts(self, handles: Sequence[int]) -> Sequence[tuple[Any, ...]]:
        """Add the bodies touched in the last physics step; returns all contact points with bodies that are
        not ground, as PyBullet lists them.

        `handles` are those of the bodies that the robot can have touched, or ANY_BODY.
        """
        found: list[tuple[Any, ...]] = []
        body, numbers = self._body, self._numbers
        for handle in handles:
            # Names of arguments would take PyBullet a fifth of the call.
            points = pybullet.getContactPoints(body.handle, handle, _ANY_LINK, _ANY_LINK, body.client)
            if points:
                # Ground has no number: what remains is collisions.
                found += [point for point in points if point[2] in numbers]
        for point in found:
            if point[8] < _CONTACT_DISTANCE_M:
                self.touched.add(numbers[point[2]])
        return found

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        # PyBullet ignores negative values.
        unchanged = [-1.0] * len(self._wheel_contacts)
        rows = zip(friction, restitution, stiffness or unchanged, damping or unchanged, strict=True)
        for wheel, row in enumerate(rows):
            # PyBullet gets parameters only when they change.
            if row != self._wheel_contacts[wheel]:
                self._wheel_contacts[wheel] = row
                self._set_wheel_contact(wheel, row)

    def _set_wheel_contact(self, wheel: int, row: Sequence[float]) -> None:
        names = ("lateralFriction", "restitution", "contactStiffness", "contactDamping")
        self._body.change_dynamics(self._body.ground_links[wheel], **dict(zip(names, row, strict=True)))

    def work_j(self) -> float:
        return self.motors.work.take_j()


def _multiply(first: Sequence[float], second: Sequence[float]) -> Quadruple:
    x1, y1, z1, w1 = first
    x2, y2, z2, w2 = second
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def _rotate(quaternion: Sequence[float], vector: Sequence[float]) -> Triple:
    x, y, z, w = quaternion
    a, b, c = vector
    # v + 2 q x (q x v + w v)
    i, j, k = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
    return a + 2 * (y * k - z * j), b + 2 * (z * i - x * k), c + 2 * (x * j - y * i)


def measure_reach_m(body: LoadedBody, spec: RobotBody) -> float:
    """Upper bound [m] of the distance of any point of a loaded robot from the base's centre of mass.

    Each link adds the distance of its joint from its parent's, whatever the angles of the joints are.
    """
    robot, client = body.handle, body.client
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
    tyres = (distances[body.links[tyre.link]] + tyre.reach_m for tyre in spec.tyres)
    return max([reach, *tyres])


def _farthest_m(point: Triple, low: Triple, high: Triple) -> float:
    """Distance of the corner of a box that is farthest from a point."""
    return math.hypot(*(max(abs(a - p), abs(b - p)) for p, a, b in zip(point, low, high, strict=True)))
