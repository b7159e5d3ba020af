"""One agent in one episode: what it sees, does and is, as messages."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import rotation_from_yaw
from dune_rl.ros.codecs.codec import Stamp
from dune_rl.ros.codecs.motion import planar_pose
from dune_rl.ros.group_topics import ODOMETRY, GroupTopics, Sensed
from dune_rl.ros.library import MessageSink
from dune_rl.ros.times import time_ns_of
from dune_rl.ros.transforms import BASE, MAP, ODOM, Pose
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState, State


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
        self._scans: dict[str, dict[int, Reading]] = {name: {} for name in topics.scanners}
        self._start: Pose | None = None
        self._goal: tuple[float, ...] = ()
        self._joints: list[str] = []

    def write_action(
        self, actions: Mapping[str, Array], state: State, time_ns: int, *, as_twist: bool = True
    ) -> None:
        """Write the agent's action of `actions` (M, G, A), by group; with `as_twist` also as `cmd_vel`.

        It was chosen at a time, by an agent that goes on in `state`.
        """
        topics, types = self._topics, self._sink.types
        if self._start is None or self._has_ended(state):
            return
        action = actions[topics.group.name].reshape(-1, topics.group.action_size)[self._row]
        self._write("action", types.multi_array(action, "action"), time_ns)
        if as_twist and (twist := topics.twist(action)) is not None:
            self._write("cmd_vel", types.planar_twist(*twist), time_ns)

    def write_state(self, state: State, time_ns: int, sensed: Mapping[str, Sensed]) -> None:
        """Write what the agent sees, of what the groups have `sensed`, and is after a control step, or at the
        start.
        """
        if self._has_ended(state):
            return
        own, row = state.groups[self._topics.group.name], self._row
        pose = Pose(own.motion.position_w[row], own.motion.rotation[row])
        if self._start is None:
            self._start = Pose(pose.position, rotation_from_yaw(np.asarray(own.motion.yaw[row])))
        self._write_readings(own, pose, time_ns, sensed[self._topics.group.name])
        stamp = Stamp(self._sink.types, time_ns, self._prefix)
        if not self._topics.has_odometry:
            self._write_true_odometry(stamp, own, pose)
        for topic, message in self._truth(stamp, own, pose):
            self._write(topic, message, time_ns)
        self._write_goal(stamp, state, own)

    def _has_ended(self, state: State) -> bool:
        return bool(state.groups[self._topics.group.name].done[self._row])

    def _write_readings(self, own: GroupState, pose: Pose, time_ns: int, sensed: Sensed) -> None:
        """Write the readings that are new to the agent, at `pose`, and the frames by its own odometry."""
        row, step_s = self._row, own.episode.step_s
        steps = int(own.episode.steps[row])
        if self._topics.has_odometry:
            self._poses[steps] = pose
        for name, scans in self._scans.items():
            scans[steps] = sensed.scans[name][row].copy()
        # The agent's own steps count from when it came.
        came_ns = time_ns - time_ns_of(steps, step_s)
        values = {name: each[row] for name, each in sensed.readings.items()}
        for name, codec in self._topics.codecs.items():
            taken = self._topics.timing[name].taken(steps)
            if self._taken.get(name) == taken:
                continue
            self._taken[name] = taken
            moves = name == ODOMETRY and self._topics.has_odometry
            past: dict[int, Any] | None = self._poses if moves else self._scans.get(name)
            if past is not None and taken not in past:
                # Of a last observation, in the middle of a held action; nobody acts on it.
                continue
            if name in self._scans:
                values[name] = self._scans[name][taken]
            stamp = Stamp(self._sink.types, came_ns + time_ns_of(taken, step_s), self._prefix)
            for topic, message in codec.encode(stamp, values):
                self._write(topic, message, time_ns)
            if moves:
                reckoned = planar_pose(*values[name][:3].tolist())
                self._write_frames(stamp, self._poses[taken] @ reckoned.inverse, reckoned, time_ns)
            if past is not None:
                for step in [step for step in past if step <= taken]:
                    del past[step]

    def _truth(self, stamp: Stamp, own: GroupState, pose: Pose) -> Iterator[tuple[str, Any]]:
        row, types = self._row, stamp.types
        header = types.header(stamp.time_ns, MAP)
        yield "ground_truth/odom", types.odometry(header, self._prefix + BASE, pose, self._twist(own))
        joints = own.motion.joints
        if joints is not None:
            self._joints = self._joints or self._topics.joint_names(row, joints.angle.shape[1])
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

    def _twist(self, own: GroupState) -> Any:
        """The true Twist, in the body's frame."""
        return self._sink.types.twist(own.motion.velocity_b[self._row], own.motion.angular_b[self._row])

    def _write_true_odometry(self, stamp: Stamp, own: GroupState, pose: Pose) -> None:
        """Write odometry without errors, from the start, for a robot whose sensors have none."""
        assert self._start is not None
        moved = self._start.inverse @ pose
        message = stamp.types.odometry(stamp.header(ODOM), self._prefix + BASE, moved, self._twist(own))
        self._write("odom", message, stamp.time_ns)
        self._write_frames(stamp, self._start, moved, stamp.time_ns)

    def _write_frames(self, stamp: Stamp, odom: Pose, base: Pose, time_ns: int) -> None:
        """Write the frame odom in the map, and that of the body in odom."""
        types, prefix = stamp.types, self._prefix
        transforms = [
            types.transform(types.header(stamp.time_ns, MAP), prefix + ODOM, odom),
            types.transform(stamp.header(ODOM), prefix + BASE, base),
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
        pose = stamp.types.pose(Pose(np.array([*place, height]), np.eye(3)))
        message = stamp.types.make(
            "geometry_msgs/PoseStamped", header=stamp.types.header(stamp.time_ns, MAP), pose=pose
        )
        self._sink.write(f"/{self._prefix}goal_pose", message, stamp.time_ns, latched=True)

    def _write(self, topic: str, message: Any, time_ns: int) -> None:
        self._sink.write(f"/{self._prefix}{topic}", message, time_ns)
