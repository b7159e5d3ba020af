"""A robot in a PyBullet scene: its base link, its contacts and its reach."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dune_rl.physics.bullet.loading import BodyLoader, LoadedBody
from dune_rl.physics.bullet.motors import BulletMotors
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.varied_body import BodyVariation

with suppress_stderr():
    import pybullet

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


@dataclass(frozen=True)
class InertialFrame:
    """Pose of a link's inertial frame in its link frame: origin (3) [m] and quaternion xyzw (4)."""

    origin_b: Sequence[float]
    quaternion_b: Sequence[float]

    @property
    def is_identity(self) -> bool:
        """Whether the inertial frame is the link frame."""
        return not any(self.origin_b) and not any(self.quaternion_b[:3])

    def link_state(
        self,
        centre_w: Sequence[float],
        quaternion: Sequence[float],
        velocity_w: Sequence[float],
        angular_w: Sequence[float],
    ) -> tuple[Triple, Quadruple, Triple]:
        """Position [m], quaternion and velocity [m/s] of the link frame's origin.

        Arguments are the pose and the velocities of the inertial frame, all in the world frame.
        """
        x, y, z, w = self.quaternion_b
        link_quaternion = _multiply(quaternion, (-x, -y, -z, w))
        ax, ay, az = _rotate(link_quaternion, self.origin_b)
        ox, oy, oz = angular_w
        return (
            (centre_w[0] - ax, centre_w[1] - ay, centre_w[2] - az),
            link_quaternion,
            (
                velocity_w[0] - (oy * az - oz * ay),
                velocity_w[1] - (oz * ax - ox * az),
                velocity_w[2] - (ox * ay - oy * ax),
            ),
        )


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


# Position, quaternion, linear and angular velocity.
_State = tuple[Triple, Quadruple, Triple, Triple]


class BaseLink:
    """Reads the state of the base link of `body`, once between physics steps, and applies forces to it."""

    def __init__(self, body: LoadedBody) -> None:
        self._body = body
        self._state: _State | None = None
        self._frame: InertialFrame | None = None
        self._force: Sequence[float] | None = None

    def reset(self) -> None:
        """Drop the state and the force."""
        self._state = self._force = None

    def measure_mass_kg(self) -> float:
        """Mass of the base link, which may differ after each load, as may its centre, which is kept."""
        info = pybullet.getDynamicsInfo(self._body.handle, -1, physicsClientId=self._body.client)
        frame = InertialFrame(info[3], info[4])
        self._frame = None if frame.is_identity else frame
        mass: float = info[0]
        return mass

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._state = None

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the centre of mass, and speed [m/s] in all three directions."""
        position, _, velocity, _ = self.read()
        return position[0], position[1], math.hypot(*velocity)

    def velocity_xy(self) -> tuple[float, float]:
        """Horizontal velocity of the centre of mass [m/s]."""
        state = self._state
        velocity = (
            pybullet.getBaseVelocity(self._body.handle, self._body.client)[0] if state is None else state[2]
        )
        return velocity[0], velocity[1]

    def link_state(self) -> tuple[float, ...]:
        """See `PhysicsRobot.body_state`."""
        position, quaternion, linear, angular = self.read()
        if self._frame is not None:
            position, quaternion, linear = self._frame.link_state(position, quaternion, linear, angular)
        return (*position, *quaternion, *linear, *angular)

    def read(self) -> _State:
        """Pose and velocities of the inertial frame, read once between physics steps."""
        state = self._state
        if state is None:
            robot, client = self._body.handle, self._body.client
            self._state = state = (
                *pybullet.getBasePositionAndOrientation(robot, client),
                *pybullet.getBaseVelocity(robot, client),
            )
        return state

    def set_force(self, force_w: Sequence[float]) -> None:
        """Set what the next `take_force` returns: a force (3) [N], world frame."""
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force set by `set_force` since the last call, which is removed; None if there is none."""
        force, self._force = self._force, None
        return force

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N], world frame, to the centre of mass in the next physics step."""
        # The engine clears forces after each physics step.
        robot, client = self._body.handle, self._body.client
        centre, _ = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
        pybullet.applyExternalForce(robot, -1, force_w, centre, pybullet.WORLD_FRAME, physicsClientId=client)


# Contact points closer than this count as contacts.
_CONTACT_DISTANCE_M = 1e-3
# What `getContactPoints` takes for any other body, and any link.
ANY_BODY, _ANY_LINK = -1, -2


class TouchedBodies:
    """The bodies that `body` touched since the last `clear`, without ground.

    `numbers` maps PyBullet's handles of the bodies that are not ground to body
    numbers; the scene updates it.
    """

    def __init__(self, body: LoadedBody, numbers: Mapping[int, int]) -> None:
        self._body, self._numbers = body, numbers
        self._touched: set[int] = set()

    def clear(self) -> None:
        """Forget all contacts."""
        self._touched.clear()

    def record(self, handles: Sequence[int]) -> Sequence[tuple[Any, ...]]:
        """Add the bodies touched in the last physics step; returns all contact points with bodies that are
        not ground, as PyBullet lists them.

        `handles` are those of the bodies that the robot can have touched, or ANY_BODY.
        """
        found: list[tuple[Any, ...]] = []
        for handle in handles:
            # Names of arguments would take PyBullet a fifth of the call.
            points = pybullet.getContactPoints(
                self._body.handle, handle, _ANY_LINK, _ANY_LINK, self._body.client
            )
            if points:
                # Ground has no number: what remains is collisions.
                found += [point for point in points if point[2] in self._numbers]
        for point in found:
            if point[8] < _CONTACT_DISTANCE_M:
                self._touched.add(self._numbers[point[2]])
        return found

    def in_order(self) -> list[int]:
        """Body numbers in ascending order."""
        return sorted(self._touched)


class WheelContacts:
    """Contact parameters of the W ground links of `body`, which PyBullet gets only when they change."""

    def __init__(self, body: LoadedBody) -> None:
        self._body = body
        # Friction, restitution, stiffness and damping of each wheel; empty as long as they are those loaded.
        self._rows: list[tuple[float, ...]] = []

    def reset(self) -> None:
        """Forget the parameters of a robot that was replaced by one at the start."""
        self._rows = [() for _ in self._body.ground_links]

    def set(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        """Set the parameters, (W) each; see `PhysicsRobot.set_wheel_contacts`."""
        # PyBullet ignores negative values.
        unchanged = [-1.0] * len(self._rows)
        rows = zip(friction, restitution, stiffness or unchanged, damping or unchanged, strict=True)
        for wheel, row in enumerate(rows):
            if row != self._rows[wheel]:
                self._rows[wheel] = row
                self._apply(wheel, row)

    def apply_again(self) -> None:
        """Give all parameters to a robot that was loaded anew in the same state."""
        for wheel, row in enumerate(self._rows):
            if row:
                self._apply(wheel, row)

    def _apply(self, wheel: int, row: Sequence[float]) -> None:
        body = self._body
        pybullet.changeDynamics(
            body.handle,
            body.ground_links[wheel],
            lateralFriction=row[0],
            restitution=row[1],
            contactStiffness=row[2],
            contactDamping=row[3],
            physicsClientId=body.client,
        )


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


class BulletRobot:
    """A `PhysicsRobot` in the PyBullet `client`.

    `body_numbers` maps PyBullet's handles of the bodies that are not ground to
    body numbers; the scene updates it. `hull_mask` has the collision groups
    that the hull collides with.

    `base`, `motors` and `touched` are for the scene, which calls them in every
    physics step; they stay the same objects over `load` and `reload`.
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
        self._spec = spec
        self._body = LoadedBody(client, spec)
        self._loader = BodyLoader(self._body, spec, hull_mask)
        self._wheels = WheelContacts(self._body)
        self.base = BaseLink(self._body)
        self.motors = BulletMotors(self._body, spec, timestep_s, measures_work=measures_work)
        self.touched = TouchedBodies(self._body, body_numbers)
        # The rest of `PhysicsRobot` and `GatedRobot`, without a call in between.
        self.set_start_pose, self.joint_angles = self._loader.set_start_pose, self._body.joint_angles
        self.remove, self.release = self._body.remove, self._body.release
        self.apply_force, self.body_state = self.base.set_force, self.base.link_state
        self.planar_motion = self.base.planar_motion
        self.drive_state, self.work_j = self.motors.joint_states, self.motors.take_work_j
        self.set_wheel_contacts, self.contacts = self._wheels.set, self.touched.in_order
        # See `GatedRobot`; the position is that of the base's centre of mass. Infinite until it is measured.
        self.reach_m = math.inf
        self.base_mass_kg = 0.0

    def set_body(self, variation: BodyVariation) -> None:
        self.motors.set_strength(variation.motor_strength)
        self._loader.set_variation(variation)
        # The centre of mass, which the reach is about, may move.
        self.reach_m = math.inf

    def load(self) -> int:
        """Load the robot at its start pose, without tyres, and return PyBullet's handle."""
        handle = self._loader.load()
        self.base_mass_kg = self.base.measure_mass_kg()
        self.base.reset()
        self.motors.reset()
        self.touched.clear()
        self._wheels.reset()
        if self.reach_m == math.inf:
            self.reach_m = measure_reach_m(self._body, self._spec)
        return handle

    def reload(self, tyres: frozenset[int]) -> int:
        """Replace the robot by one with other tyres, in the same state, and return its handle."""
        handle = self._loader.reload(tyres)
        self.base_mass_kg = self.base.measure_mass_kg()
        self._wheels.apply_again()
        return handle

    def begin_step(self, count: int) -> None:
        """Forget what was touched, and pass the commands to the motors for `count` physics steps."""
        self.touched.clear()
        self.motors.begin_step(count)

    def end_step(self) -> None:
        """Read the state after a control step at once, while the processor still has it in its cache."""
        self.mark_moved()
        self.base.read()
        self.motors.read_speeds()

    def mark_moved(self) -> None:
        """Drop what was read before a physics step."""
        self.base.mark_moved()
        self.motors.mark_moved()

    def set_command(self, commands: Sequence[float]) -> None:
        self.motors.commands = commands
