"""One agent in one episode: what it sees, does and is, as messages."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import rotation_from_yaw
from dune_rl.ros.codecs.codec import Stamp
from dune_rl.ros.codecs.motion import planar_pose
from dune_rl.ros.group_topics import ODOMETRY, GroupTopics
from dune_rl.ros.library import MessageSink
from dune_rl.ros.times import time_ns_of
from dune_rl.ros.transforms import BASE, MAP, ODOM, relative_pose
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState, State

Pose = tuple[Array, Array]


class AgentRecording:
    """Writes the topics of the agent in `row` of a group into `sink`, such as the bag of its episode.

    `prefix` is the namespace of its topics and frames, such as `rover_0/`, or "". It writes from when the
    agent is there until its own episode ends.
    """

    def __init__(self, sink: MessageSink, topics: GroupTopics, row: int, prefix: str) -> None:
        self._sink, self._topics, self._row, self._prefix = sink, topics, row, prefix
        self._taken: dict[str, int] = {}
        # By control step of the agent, as far back as a reading that has not arrived yet was taken.
        self._poses: dict[int, Pose] = {}
        self._scans: dict[str, dict[int, Reading]] = {name: {} for name in topics.scans()}
        self._start: Pose | None = None
        self._goal: tuple[float, ...] = ()
        self._joints: list[str] = []

    @property
    def begun(self) -> bool:
        """Whether the agent has come."""
        return self._start is not None

    def write_action(self, action: Array, time_ns: int, *, as_twist: bool = True) -> None:
        """Write the action (A,) that was chosen at a time; with `as_twist` also as `cmd_vel`."""
        types = self._sink.types
        self._write("action", types.multi_array(action, "action"), time_ns)
        twist = self._topics.twist(action) if as_twist else None
        if twist is not None:
            speed, turn = twist
            message = types.twist(np.array([speed, 0.0, 0.0]), np.array([0.0, 0.0, turn]))
            self._write("cmd_vel", message, time_ns)

    def write_state(
        self, state: State, time_ns: int, readings: Mapping[str, Reading], scans: Mapping[str, Reading]
    ) -> None:
        """Write what the agent sees and is after a control step, or at the start; arrays are (N, ...)."""
        own = state.groups[self._topics.group.name]
        row, step_s = self._row, own.episode.step_s
        steps = int(own.episode.steps[row])
        pose: Pose = own.motion.position_w[row], own.motion.rotation[row]
        self._poses[steps] = pose
        if self._start is None:
            yaw = own.motion.yaw[row]
            self._start = pose[0], rotation_from_yaw(np.asarray(yaw))
        for name, kept in self._scans.items():
            kept[steps] = scans[name][row].copy()
        # The agent's own steps count from when it came.
        came_ns = time_ns - time_ns_of(steps, step_s)
        values = {name: each[row] for name, each in readings.items()}
        for name, codec in self._topics.codecs.items():
            taken = self._topics.timing[name].taken(steps)
            if self._taken.get(name) == taken:
                continue
            self._taken[name] = taken
            follows = name == ODOMETRY and self._topics.has_odometry
            past: dict[int, Any] | None = self._poses if follows else self._scans.get(name)
            if past is not None and taken not in past:
                # Of a last observation, in the middle of a held action; nobody acts on it.
                continue
            if name in self._scans:
                values[name] = self._scans[name][taken]
                self._scans[name] = {step: scan for step, scan in self._scans[name].items() if step > taken}
            stamp = Stamp(self._sink.types, came_ns + time_ns_of(taken, step_s), self._prefix)
            for topic, message in codec.encode(stamp, values):
                self._write(topic, message, time_ns)
            if follows:
                inner = planar_pose(values[name][:3].astype(np.float64))
                self._write_frames(stamp, relative_pose(self._poses[taken], inner), inner, time_ns)
                self._poses = {step: each for step, each in self._poses.items() if step > taken}
        stamp = Stamp(self._sink.types, time_ns, self._prefix)
        if not self._topics.has_odometry:
            self._poses.clear()
            self._write_true_odometry(stamp, own, pose)
        for topic, message in self._truth(stamp, own, pose):
            self._write(topic, message, time_ns)
        self._write_goal(stamp, state, own)

    def _truth(self, stamp: Stamp, own: GroupState, pose: Pose) -> Iterator[tuple[str, Any]]:
        row, types = self._row, stamp.types
        header = types.header(stamp.time_ns, MAP)
        twist = own.motion.velocity_b[row], own.motion.angular_b[row]
        yield "ground_truth/odom", types.odometry(header, self._prefix + BASE, pose, twist)
        joints = own.motion.joints
        if joints is not None:
            if not self._joints:
                self._joints = self._topics.joint_names(row, joints.angle.shape[1])
            yield (
                "joint_states",
                types.make(
                    "sensor_msgs/JointState",
                    header=stamp.header(BASE),
                    name=self._joints,
                    position=joints.angle[row].copy(),
                    velocity=joints.speed[row].copy(),
                    effort=joints.torque[row].copy(),
                ),
            )
        yield "in_contact", types.make("std_msgs/Bool", data=bool(own.contacts.touching[row]))
        yield "collisions", types.make("std_msgs/UInt32", data=int(own.contacts.total[row]))

    def _write_true_odometry(self, stamp: Stamp, own: GroupState, pose: Pose) -> None:
        """Write odometry without errors, from the start, for a robot whose sensors have none."""
        assert self._start is not None
        position, turned = self._start
        inner = turned.T @ (pose[0] - position), turned.T @ pose[1]
        twist = own.motion.velocity_b[self._row], own.motion.angular_b[self._row]
        message = stamp.types.odometry(stamp.header(ODOM), self._prefix + BASE, inner, twist)
        self._write("odom", message, stamp.time_ns)
        self._write_frames(stamp, self._start, inner, stamp.time_ns)

    def _write_frames(self, stamp: Stamp, odom: Pose, base: Pose, time_ns: int) -> None:
        """Write the frame odom in the map, and that of the body in odom."""
        types, prefix = stamp.types, self._prefix
        transforms = [
            types.transform(types.header(stamp.time_ns, MAP), prefix + ODOM, *odom),
            types.transform(stamp.header(ODOM), prefix + BASE, *base),
        ]
        self._sink.write("/tf", types.make("tf2_msgs/TFMessage", transforms=transforms), time_ns)

    def _write_goal(self, stamp: Stamp, state: State, own: GroupState) -> None:
        """Write the goal's true place, with the height of the ground there, when it is another one."""
        if not self._topics.has_goal:
            return
        place = own.goal.position_w[self._row]
        if tuple(place.tolist()) == self._goal:
            return
        self._goal = tuple(place.tolist())
        scene = np.array([self._row // own.count])
        height = float(state.ground.height(place[None], scene)[0])
        pose = stamp.types.pose(np.array([*place, height]), np.eye(3))
        message = stamp.types.make(
            "geometry_msgs/PoseStamped", header=stamp.types.header(stamp.time_ns, MAP), pose=pose
        )
        self._sink.write(f"/{self._prefix}goal_pose", message, stamp.time_ns, latched=True)

    def _write(self, topic: str, message: Any, time_ns: int) -> None:
        self._sink.write(f"/{self._prefix}{topic}", message, time_ns)
