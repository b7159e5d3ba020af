"""What codecs of sensors share: topics, stamps, arrays, and where a sensor is turned to."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Bytes
from dune_rl.geometry.frames import roll_pitch_yaw
from dune_rl.ros.library import MessageTypes
from dune_rl.ros.transforms import FrameMount, TransformTree
from dune_rl.sensors.sensor import Reading

ARRAYS = ("std_msgs/Float32MultiArray", "std_msgs/UInt8MultiArray")


class MessageError(ConfigError):
    """A message that is of another size, field of view or frame than the policy's sensor."""


@dataclass(frozen=True)
class Channel:
    """A topic, without the robot's namespace, and the type of its messages."""

    topic: str
    type: str


@dataclass(frozen=True)
class Stamp:
    """When a reading was taken [ns], and the namespace of its robot, with which its frames begin."""

    types: MessageTypes
    time_ns: int
    namespace: str = ""

    def header(self, frame: str) -> Any:
        return self.types.header(self.time_ns, self.namespace + frame)


@dataclass(frozen=True)
class Source:
    """What a part of an observation is read from: its default topic, and the types that it may have."""

    topic: str
    types: tuple[str, ...]


def data_rows(message: Any, step: int, used: int) -> Bytes:
    """The first `used` bytes of each row of an Image or a PointCloud2, (height, used).

    `step` is the length of a row with what it is padded by. Raises MessageError where the data are shorter
    than the message says.
    """
    data = np.asarray(message.data, np.uint8)
    if step < used or len(data) < message.height * step:
        raise MessageError(
            f"it has {len(data)} bytes in rows of {step}, and needs {message.height} rows of at least {used}"
        )
    return data[: message.height * step].reshape(message.height, step)[:, :used]


class SensorCodec:
    """Base of codecs: one sensor's readings as messages, both ways.

    `channels` are what it writes, `mounts` its fixed frames, and `sources` where each reading comes from, the
    best one first.
    """

    channels: tuple[Channel, ...]
    mounts: tuple[FrameMount, ...] = ()
    sources: Mapping[str, tuple[Source, ...]]

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        """Topics and messages of one robot's `readings`, by name."""
        raise NotImplementedError

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        """The reading of a message of its source; raises MessageError where that cannot be.

        `frames` are the robot's, whose body is the frame `base`.
        """
        raise NotImplementedError


class ArrayCodec(SensorCodec):
    """Readings as arrays under `observation/`, for sensors without a standard message."""

    def __init__(self, shapes: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
        """`shapes` are the shape and the type of each reading by name."""
        self._shapes = dict(shapes)
        kinds = {name: ARRAYS[dtype == np.uint8] for name, (_, dtype) in shapes.items()}
        self.channels = tuple(Channel(f"observation/{name}", kind) for name, kind in kinds.items())
        self.sources = {name: (Source(f"observation/{name}", (kind,)),) for name, kind in kinds.items()}

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        for name in self._shapes:
            yield f"observation/{name}", stamp.types.multi_array(readings[name], name)

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        shape, dtype = self._shapes[reading]
        values = np.asarray(message.data, dtype)
        if values.size != int(np.prod(shape)):
            raise MessageError(f"it has {values.size} numbers, and {reading} has {int(np.prod(shape))}")
        return values.reshape(shape)


def topic_of(name: str, kind: str, topic: str) -> str:
    """`topic` for the sensor that is called after its kind, and `NAME/topic` for another one."""
    return topic if name == kind else f"{name}/{topic}"


def yaw_on_base(frame: str, frames: TransformTree, base: str) -> float:
    """Heading [rad] of a sensor's frame on the body; raises MessageError where no transform leads there."""
    if not frame or frame.lstrip("/") == base.lstrip("/"):
        return 0.0
    pose = frames.pose(frame, base)
    if pose is None:
        raise MessageError(
            f"its frame {frame!r} has no transform to {base!r} in /tf_static; record that, or give base=FRAME"
        )
    return float(roll_pitch_yaw(pose.rotation)[2])
