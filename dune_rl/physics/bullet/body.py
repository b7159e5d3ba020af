"""A robot as PyBullet has loaded it: its handle, and the indices of its joints and links."""

from collections.abc import Sequence

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.bullet.tyres import tyre_link_name
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody

with suppress_stderr():
    import pybullet


class LoadedBody:
    """The body of a robot in the PyBullet `client`, for all objects that read or command it.

    `handle` is PyBullet's, None while the robot is not loaded. A link has the
    index of the joint above it, and the base link -1. `joints` and `links` map
    names to indices; `movable` has the joints that are not fixed, `axes` the
    axis (3) of each joint. `drive_joints` and `ground_links` are in the order
    of the `RobotBody`; `tyre_links` are those of the tyres that were loaded.
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

    def release(self) -> None:
        """Drop the handle after the client was disconnected."""
        self.handle = None

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        """Angles [rad] of joints by name; 0 while the robot is not loaded."""
        if self.handle is None:
            return (0.0,) * len(joints)
        indices = [self.joints[name] for name in joints]
        states = pybullet.getJointStates(self.handle, indices, physicsClientId=self.client)
        return tuple(state[0] for state in states)
