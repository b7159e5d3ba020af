"""Sensors of a robot's own motion as messages: Imu, Odometry, TwistStamped, and the goal out of a pose."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import roll_pitch_yaw, rotation_from_angles, rotation_from_yaw, wrap_angle
from dune_rl.ros.codecs.codec import (
    ARRAYS,
    ArrayCodec,
    Channel,
    MessageError,
    SensorCodec,
    Source,
    Stamp,
    topic_of,
)
from dune_rl.ros.transforms import BASE, ODOM, FrameMount, Pose, TransformTree, is_rotation, rotation_of
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.sensor import Reading

_IMU, _ODOMETRY, _TWIST = "sensor_msgs/Imu", "nav_msgs/Odometry", "geometry_msgs/TwistStamped"
_PLAIN_TWIST, _POSE = "geometry_msgs/Twist", "geometry_msgs/PoseStamped"
_GOAL_SIZE = 2


class ImuCodec(SensorCodec):
    """An inertial unit: specific force (with gravity), angular velocity, and orientation in the world."""

    def __init__(self, name: str, conf: ImuConf) -> None:
        self._name, self._topic, self._frame = name, topic_of(name, "imu", "imu"), f"{name}_link"
        self._limits = conf.acceleration_range_mps2, conf.angular_range_radps
        self.channels = (Channel(self._topic, _IMU),)
        self.mounts = (FrameMount.on_base(self._frame, conf.mount_b),)
        self.sources = {name: (Source(self._topic, (_IMU,)),)}

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        types, values = stamp.types, readings[self._name].astype(np.float64)
        unknown = np.zeros(9)
        yield (
            self._topic,
            types.make(
                _IMU,
                header=stamp.header(self._frame),
                orientation=types.quaternion(rotation_from_angles(values[6:9])),
                orientation_covariance=unknown,
                angular_velocity=types.vector(values[3:6]),
                angular_velocity_covariance=unknown,
                linear_acceleration=types.vector(values[0:3]),
                linear_acceleration_covariance=unknown,
            ),
        )

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        """The reading (9,); raises MessageError for a unit without an orientation."""
        if message.orientation_covariance[0] < 0.0:
            raise MessageError(
                f"it has no orientation (its covariance begins with -1), which {reading} needs; add one by a "
                "filter"
            )
        force, turn = message.linear_acceleration, message.angular_velocity
        angles = _angles_of(message.orientation)
        most_force, most_turn = self._limits
        found = np.array([force.x, force.y, force.z, turn.x, turn.y, turn.z, *angles])
        found[:3] = np.clip(found[:3], -most_force, most_force)
        found[3:6] = np.clip(found[3:6], -most_turn, most_turn)
        return found.astype(np.float32)


def _angles_of(orientation: Any) -> Array:
    """Roll, pitch and yaw (3,) [rad]; raises MessageError for a Quaternion that is no rotation."""
    if not is_rotation(orientation):
        parts = ", ".join(f"{getattr(orientation, axis):g}" for axis in "xyzw")
        raise MessageError(f"its orientation ({parts}) is no unit quaternion; add one by a filter")
    return roll_pitch_yaw(rotation_of(orientation))


class OdometryCodec(SensorCodec):
    """Dead reckoning: the pose in the frame `odom`, which is that of the start, and the twist of the body."""

    def __init__(self, name: str) -> None:
        self._name, self._topic = name, topic_of(name, "odometry", "odom")
        self.channels = (Channel(self._topic, _ODOMETRY),)
        self.sources = {name: (Source(self._topic, (_ODOMETRY,)),)}

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        x, y, yaw, speed, turn = readings[self._name].tolist()
        header = stamp.header(topic_of(self._name, "odometry", ODOM))
        twist = stamp.types.planar_twist(speed, turn)
        yield (
            self._topic,
            stamp.types.odometry(header, stamp.namespace + BASE, planar_pose(x, y, yaw), twist),
        )

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        at, twist = message.pose.pose, message.twist.twist
        yaw = _angles_of(at.orientation)[2]
        found = [at.position.x, at.position.y, yaw, twist.linear.x, twist.angular.z]
        return np.array(found, np.float32)


def planar_pose(x: float, y: float, yaw: float) -> Pose:
    """The pose at x, y [m] and yaw [rad] on the ground."""
    return Pose(np.array([x, y, 0.0]), rotation_from_yaw(np.asarray(yaw)))


class VelocityCodec(SensorCodec):
    """The known speed and yaw rate: a TwistStamped of the body; out of an Odometry or a Twist as well."""

    def __init__(self, name: str) -> None:
        self._name, self._topic = name, topic_of(name, "velocity", "velocity")
        self.channels = (Channel(self._topic, _TWIST),)
        self.sources = {name: (Source(self._topic, (_TWIST, _ODOMETRY, _PLAIN_TWIST)),)}

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        twist = stamp.types.planar_twist(*readings[self._name].tolist())
        yield self._topic, stamp.types.make(_TWIST, header=stamp.header(BASE), twist=twist)

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        twist = message
        while hasattr(twist, "twist"):
            twist = twist.twist
        return np.array([twist.linear.x, twist.angular.z], np.float32)


class GoalCodec(ArrayCodec):
    """The known distance and bearing of the goal as an array; out of a PoseStamped as well.

    Of a pose they are those from the body's pose in the goal's frame, by /tf.
    """

    def __init__(self, name: str) -> None:
        super().__init__({name: ((_GOAL_SIZE,), np.float32)})
        known = Source(f"observation/{name}", (ARRAYS[0], _POSE))
        self.sources = {name: (known, Source("goal_pose", (_POSE,)))}

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        if not hasattr(message, "pose"):
            return super().decode(reading, message, frames, base)
        frame, at = message.header.frame_id, message.pose.position
        pose = frames.pose(base, frame)
        if pose is None:
            raise MessageError(
                f"its frame {frame!r} has no transform to {base!r} in /tf; record that, or give base=FRAME"
            )
        position, rotation = pose
        offset = np.array([at.x, at.y]) - position[:2]
        heading = roll_pitch_yaw(rotation)[2]
        bearing = wrap_angle(np.arctan2(offset[1], offset[0]) - heading)
        return np.array([np.hypot(*offset), bearing], np.float32)
