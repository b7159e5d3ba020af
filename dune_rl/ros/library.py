"""The library `rosbags`, which reads and writes bags without ROS, and the messages that it knows."""

from functools import cache
from typing import Any, Protocol

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import quaternions
from dune_rl.ros.times import NS_PER_S
from dune_rl.ros.transforms import Pose


def require_rosbags(setting: str = "bag=FOLDER") -> None:
    """Raise ConfigError, which says what `setting` needs, where `rosbags` is not installed."""
    try:
        import rosbags.rosbag2
        import rosbags.typesys  # noqa: F401
    except ImportError:
        raise ConfigError(f"{setting} needs rosbags: pip install 'dune_rl[ros]'") from None


@cache
def message_types() -> "MessageTypes":
    """The standard messages of ROS 2 Humble, whose definitions later releases share."""
    require_rosbags()
    from rosbags.typesys import Stores, get_typestore

    return MessageTypes(get_typestore(Stores.ROS2_HUMBLE))


class MessageTypes:
    """Makes messages by their types' short names, such as `sensor_msgs/LaserScan`; times are in ns."""

    def __init__(self, store: Any) -> None:
        self.store = store

    def make(self, name: str, /, **fields: Any) -> Any:
        """A message with these fields; all of a type must be given."""
        return self.store.types[full_name(name)](**fields)

    def serialize(self, message: Any) -> memoryview:
        """The message as CDR, in which bags keep it."""
        data: memoryview = self.store.serialize_cdr(message, message.__msgtype__)
        return data

    def time(self, time_ns: int) -> Any:
        return self.make("builtin_interfaces/Time", sec=time_ns // NS_PER_S, nanosec=time_ns % NS_PER_S)

    def header(self, time_ns: int, frame: str) -> Any:
        return self.make("std_msgs/Header", stamp=self.time(time_ns), frame_id=frame)

    def vector(self, values: Array) -> Any:
        """A Vector3 of (3,)."""
        x, y, z = map(float, values)
        return self.make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def quaternion(self, rotation: Array) -> Any:
        """A Quaternion of a rotation matrix (3, 3)."""
        x, y, z, w = quaternions(rotation).tolist()
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, pose: Pose) -> Any:
        x, y, z = map(float, pose.position)
        point = self.make("geometry_msgs/Point", x=x, y=y, z=z)
        return self.make("geometry_msgs/Pose", position=point, orientation=self.quaternion(pose.rotation))

    def twist(self, linear: Array, angular: Array) -> Any:
        return self.make("geometry_msgs/Twist", linear=self.vector(linear), angular=self.vector(angular))

    def transform(self, header: Any, child: str, pose: Pose) -> Any:
        """A TransformStamped of `child`, at `pose` in the header's frame."""
        inner = self.make(
            "geometry_msgs/Transform",
            translation=self.vector(pose.position),
            rotation=self.quaternion(pose.rotation),
        )
        return self.make(
            "geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=inner
        )

    def planar_twist(self, speed_mps: float, yaw_rate_radps: float) -> Any:
        """A Twist ahead and about the vertical."""
        return self.twist(np.array([speed_mps, 0.0, 0.0]), np.array([0.0, 0.0, yaw_rate_radps]))

    def odometry(self, header: Any, child: str, pose: Pose, twist: Any) -> Any:
        """An Odometry of the pose of `child`, and of a Twist in that frame."""
        unknown = np.zeros(36)
        return self.make(
            "nav_msgs/Odometry",
            header=header,
            child_frame_id=child,
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=self.pose(pose), covariance=unknown),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=unknown),
        )

    def multi_array(self, values: Any, label: str) -> Any:
        """A Float32MultiArray of any shape, or a UInt8MultiArray of bytes; `label` is of its first axis."""
        kind = "UInt8" if values.dtype == np.uint8 else "Float32"
        sizes = values.shape
        dimensions = [
            self.make(
                "std_msgs/MultiArrayDimension",
                label=label if axis == 0 else f"axis_{axis}",
                size=size,
                stride=int(np.prod(sizes[axis:])),
            )
            for axis, size in enumerate(sizes)
        ]
        layout = self.make("std_msgs/MultiArrayLayout", dim=dimensions, data_offset=0)
        flat = np.ascontiguousarray(values, np.uint8 if kind == "UInt8" else np.float32).reshape(-1)
        return self.make(f"std_msgs/{kind}MultiArray", layout=layout, data=flat)


class MessageSink(Protocol):
    """What messages are written to: a bag, or the topics of a network."""

    types: MessageTypes

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Add a message of `topic` at a time; a `latched` one is kept for those who come later."""


@cache
def full_name(name: str) -> str:
    """The type's name in bags: `std_msgs/msg/Bool` of `std_msgs/Bool`."""
    package, _, message = name.partition("/")
    return f"{package}/msg/{message}"


def latched_qos() -> Any:
    """The quality of service of topics whose last message is kept for those who come later."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, never, never,
        QosLiveliness.AUTOMATIC, never, False,
    )  # fmt: skip
