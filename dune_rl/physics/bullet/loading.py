"""Loading of a robot into PyBullet: its URDF, with varied masses and tyres, its links and its joints."""

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

from scipy.spatial.transform import Rotation

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.bullet.client import pybullet
from dune_rl.physics.process import share_by_identity
from dune_rl.physics.robot_body import (
    AS_DESCRIBED,
    BodyVariation,
    RobotBody,
    Tyre,
    read_urdf_body,
)

# Axis of a tyre in the frame of its link.
TYRE_AXIS = (0.0, 0.0, 1.0)
_ENDING = "/tyre"


def tyre_link_name(tyre: Tyre) -> str:
    """Name of the link that a tyre has."""
    return f"{tyre.link}{_ENDING}"


def _add_tyre_link(root: Element, tyre: Tyre) -> None:
    """Add a link for a tyre to a URDF: a cylinder without mass fixed to the wheel."""
    name = tyre_link_name(tyre)
    link = SubElement(root, "link", name=name)
    # PyBullet gives a link without these 1 kg.
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value="0")
    SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
    geometry = SubElement(SubElement(link, "collision"), "geometry")
    SubElement(geometry, "cylinder", radius=repr(tyre.radius_m), length=repr(tyre.width_m))
    joint = SubElement(root, "joint", name=name, type="fixed")
    SubElement(joint, "parent", link=tyre.link)
    SubElement(joint, "child", link=name)
    # The link's frame is turned, and not the shape's in it: that would make a slower compound shape.
    turn, _ = Rotation.align_vectors([tyre.axis], [TYRE_AXIS])
    xyz, rpy = (
        " ".join(repr(float(part)) for part in parts) for parts in (tyre.centre, turn.as_euler("xyz"))
    )
    SubElement(joint, "origin", xyz=xyz, rpy=rpy)


class RobotUrdfs:
    """The URDFs of a robot, as it is or varied, with any of its tyres."""

    def __init__(self, spec: RobotBody, variation: BodyVariation = AS_DESCRIBED) -> None:
        # See `share_by_identity`.
        self._spec, self._variation = spec, variation
        self._texts: dict[frozenset[int], str] = {}

    def text(self, tyres: frozenset[int]) -> str:
        """The URDF with the tyres that have these indices."""
        text = self._texts.get(tyres)
        if text is None:
            root = read_urdf_body(self._spec.urdf, self._variation)
            for index in sorted(tyres):
                _add_tyre_link(root, self._spec.tyres[index])
            # PyBullet draws a link's collision shapes where it has no visual shape, and for that computes the
            # convex hull of each sphere and cylinder at every load: four fifths of a rover's time.
            for link in root.findall("link"):
                geometry = SubElement(SubElement(link, "visual"), "geometry")
                SubElement(geometry, "box", size="0.001 0.001 0.001")
            self._texts[tyres] = text = tostring(root, encoding="unicode")
        return text


# The URDFs of a robot as it is, which all scenes with the same body share.
load_shared_urdfs = share_by_identity(RobotUrdfs)


@contextmanager
def named_file(text: str) -> Iterator[str]:
    """Name of a file with `text` that exists during the block: in memory, where the system has such files.

    On a disk that is busy a file can take longer than PyBullet takes to load it.
    """
    if sys.platform == "linux" and Path("/proc/self/fd").is_dir():
        with open(os.memfd_create("dune_rl.urdf"), "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            yield f"/proc/self/fd/{file.fileno()}"
        return
    handle, name = tempfile.mkstemp(prefix="dune_rl_", suffix=".urdf")
    try:
        with open(handle, "w", encoding="utf-8") as file:
            file.write(text)
        yield name
    finally:
        Path(name).unlink()


class LoadedBody:
    """The body of a robot in the PyBullet `client`, for all objects that read or command it.

    `handle` is PyBullet's, None while the robot is not loaded. A link has the index of the joint above it,
    and the base link -1. `joints` and `links` map names to indices; `movable` has the joints that are not
    fixed, `axes` the axis (3) of each joint. `drive_joints` and `ground_links` are in the order of the
    `RobotBody`; `tyre_links` are those of the tyres that were loaded.
    """

    def __init__(self, client: int, spec: RobotBody) -> None:
        self.client, self._spec = client, spec
        self.handle: int | None = None
        self.joints: dict[str, int] = {}
        self.links: dict[str, int] = {}
        self.movable: list[int] = []
        self.axes: dict[int, Sequence[float]] = {}
        self.drive_joints: list[int] = []
        self.ground_links: list[int] = []
        self.tyre_links: list[int] = []

    def take(self, handle: int) -> None:
        """Become the body with this handle.

        Raises PhysicsError if it lacks a joint or link of the `RobotBody`.
        """
        client, spec = self.client, self._spec
        infos = [
            pybullet.getJointInfo(handle, index, physicsClientId=client)
            for index in range(pybullet.getNumJoints(handle, physicsClientId=client))
        ]
        base = pybullet.getBodyInfo(handle, physicsClientId=client)[0].decode()
        joints = {info[1].decode(): info[0] for info in infos}
        links = {base: -1} | {info[12].decode(): info[0] for info in infos}
        error = spec.describe_missing_names(joints, links)
        if error:
            raise PhysicsError(error)
        self.handle, self.joints, self.links = handle, joints, links
        self.movable = [info[0] for info in infos if info[2] != pybullet.JOINT_FIXED]
        self.axes = {info[0]: info[13] for info in infos}
        self.drive_joints = [joints[name] for name in spec.drive_joints]
        self.ground_links = [links[name] for name in spec.ground_links]
        tyre_names = [tyre_link_name(tyre) for tyre in spec.tyres]
        self.tyre_links = [links[name] for name in tyre_names if name in links]

    def remove(self) -> None:
        """Remove the body from the client, if it is loaded."""
        if self.handle is not None:
            pybullet.removeBody(self.handle, physicsClientId=self.client)
        self.handle = None

    def change_dynamics(self, link: int, **parameters: Any) -> None:
        """Set parameters of a link or of the joint above it, by PyBullet's names."""
        pybullet.changeDynamics(self.handle, link, physicsClientId=self.client, **parameters)

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        """Angles [rad] of joints by name; 0 while the robot is not loaded."""
        if self.handle is None:
            return (0.0,) * len(joints)
        indices = [self.joints[name] for name in joints]
        states = pybullet.getJointStates(self.handle, indices, physicsClientId=self.client)
        return tuple(state[0] for state in states)


# Collision groups. WHEEL is for wheels that collide with the ground only: spheres, which are wider than their
# tyres. TYRE is for these, which collide with everything else. PyBullet lets two links collide if the group
# of one is in the mask of the other, either way.
GROUND, WHEEL, HULL, OBSTACLE, TYRE = 1, 2, 4, 8, 16


def set_up_links(body: LoadedBody, spec: RobotBody, hull_mask: int) -> None:
    """Set the contact parameters and collision filters of all links of a loaded robot, and its damping.

    `hull_mask` has the collision groups that the hull collides with.
    """
    less = 1.0 - spec.sideways_friction_share
    for link in range(-1, len(body.links) - 1):
        axle: Sequence[float] | None = None
        group, mask, friction = HULL, hull_mask, spec.ground_friction
        if link in body.tyre_links:
            # Other robots have tyres, too.
            group, mask = TYRE, hull_mask & ~GROUND | (TYRE if hull_mask & HULL else 0)
            axle = TYRE_AXIS
        elif link in body.ground_links:
            axle = body.axes.get(link)
            if not spec.ground_links_meet_obstacles:
                group, mask = WHEEL, GROUND
        else:
            friction = spec.hull_friction
        pybullet.setCollisionFilterGroupMask(body.handle, link, group, mask, physicsClientId=body.client)
        body.change_dynamics(link, lateralFriction=friction, restitution=0.0, jointDamping=0.0)
        if axle is not None and less != 0.0:
            body.change_dynamics(link, anisotropicFriction=[1.0 - less * abs(part) for part in axle])
    # In a call of its own: together with one of these, PyBullet applies a link's friction to the base.
    no_sleep = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
    body.change_dynamics(-1, linearDamping=0.0, angularDamping=0.0, activationState=no_sleep)


# The force limit of a coupling is never reached. Its position error falls by the share _GEAR_ERP a second:
# above 10 it starts to oscillate. With 10 iterations Leo's rockers, on stones, have errors up to 1.2e-3 rad,
# with 20 half of that.
_GEAR_FORCE, _GEAR_ERP, GEAR_ITERATIONS = 1e4, 5.0, 20


def set_up_joints(body: LoadedBody, spec: RobotBody) -> None:
    """Disable PyBullet's default motors of passive joints, set start angles, and add couplings."""
    robot, client = body.handle, body.client
    friction = {body.joints[joint.joint]: joint.friction_nm for joint in spec.passive}
    for joint in body.movable:
        if joint not in body.drive_joints:
            force, mode = friction.get(joint, 0.0), pybullet.VELOCITY_CONTROL
            pybullet.setJointMotorControl2(
                robot, joint, mode, targetVelocity=0.0, force=force, physicsClientId=client
            )
    for passive in spec.passive:
        body.change_dynamics(body.joints[passive.joint], jointDamping=passive.damping_nms_per_rad)
    for motor in spec.motors:
        if motor.rest_rad:
            pybullet.resetJointState(robot, body.joints[motor.joint], motor.rest_rad, physicsClientId=client)
    across, origin = (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)
    for coupling in spec.couplings:
        pair = robot, body.joints[coupling.leader], robot, body.joints[coupling.follower]
        gear = pybullet.createConstraint(
            *pair, pybullet.JOINT_GEAR, across, origin, origin, physicsClientId=client
        )
        # Bullet's constraint: leader speed + gearRatio * follower speed = 0.
        pybullet.changeConstraint(
            gear,
            gearRatio=-1.0 / coupling.ratio,
            maxForce=_GEAR_FORCE,
            erp=_GEAR_ERP,
            physicsClientId=client,
        )
