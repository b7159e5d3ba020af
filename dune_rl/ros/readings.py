"""Readings of a robot out of messages, of a bag or of live topics: the latest of each topic."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from operator import matmul
from typing import Any

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import one_of
from dune_rl.ros.codecs.codec import ARRAYS, ArrayCodec, MessageError, SensorCodec, Source
from dune_rl.ros.library import full_name
from dune_rl.ros.past_scans import PastScans, PastSource
from dune_rl.ros.times import NS_PER_S, stamp_ns
from dune_rl.ros.transforms import BASE, ODOM, FrameMount, TransformTree
from dune_rl.sensors.sensor import Reading

TF, TF_STATIC = "/tf", "/tf_static"
SCAN, POSE = full_name("sensor_msgs/LaserScan"), full_name("geometry_msgs/PoseStamped")
_TRUTH = "/ground_truth/odom"
_ARRAY_NAMES = tuple(map(full_name, ARRAYS))
_SHOWN = 6
# How far a sensor may be from where a policy learnt with it, and turned from it [m, rad].
_MOST_OFFSET_M, _MOST_TURN_RAD = 0.05, np.deg2rad(3.0)


@dataclass(frozen=True)
class ReadingSource:
    """A part of an observation: its shape and type, and the codec of its sensor; None for an array's.

    A part with a `past` is a past scan: without a topic of its own, it follows from a LiDAR's scans.
    """

    array: ArrayCodec
    codec: SensorCodec | None = None
    past: PastSource | None = None

    def sources(self, part: str) -> tuple[Source, ...]:
        """Where it may come from, the standard message first."""
        standard = () if self.codec is None else self.codec.sources[part]
        return (*standard, *self.array.sources[part])


def check_parts(named: Iterable[str], parts: Collection[str]) -> None:
    """Raise ConfigError where a topic is named for a part that the policy does not read."""
    for name in named:
        if name not in parts:
            raise ConfigError(f"topics.{name}: the policy reads no {name}, but {one_of(sorted(parts))}")


class RobotReadings:
    """The readings `parts` of one robot, out of messages on topics, of which `types` has those offered.

    `robot` is the namespace of its topics and frames, `base` the frame of its body. `named` has the topics of
    parts that are not the default ones. `origin` names the bag or the network in errors, and `remedy` says
    what to do about a topic that is missing. Raises ConfigError, which says which topic is missing or does
    not fit.
    """

    def __init__(
        self,
        parts: Mapping[str, ReadingSource],
        types: Mapping[str, Collection[str]],
        named: Mapping[str, str],
        *,
        origin: str,
        remedy: str,
        robot: str | None = None,
        base: str | None = None,
    ) -> None:
        self._parts, self._offered, self._origin, self._remedy = dict(parts), dict(types), origin, remedy
        self._prefix = "" if robot is None else f"{robot.strip('/')}/"
        self._base = base or f"{self._prefix}{BASE}"
        self._past: dict[str, PastScans] = {}
        # Of each topic that is read.
        self._types: dict[str, str] = {}
        self.topics = self._choose_topics(named)
        self._parts_of: dict[str, list[str]] = {}
        for part, topic in self.topics.items():
            self._parts_of.setdefault(topic, []).append(part)
        self.frames = TransformTree()
        self._latest: dict[str, Any] = {}
        # Scans that wait for the frames of their time, which may come after them.
        self._new_scans: list[tuple[PastScans, int, Any]] = []

    # -- topics -----------------------------------------------------------------------------------

    def _choose_topics(self, named: Mapping[str, str]) -> dict[str, str]:
        """The topic of each part; raises ConfigError for all that are missing or of another type."""
        check_parts(named, self._parts)
        found, faults = {}, []
        for part, each in self._parts.items():
            sources = each.sources(part)
            kinds = [*dict.fromkeys(full_name(kind) for source in sources for kind in source.types)]
            defaults = [f"/{self._prefix}{source.topic}" for source in sources]
            asked = [named[part]] if part in named else defaults
            there = [topic for topic in asked if topic in self._offered]
            if not there and each.past is not None and part not in named:
                self._past[part] = PastScans(each.past, f"{self._prefix}{ODOM}", self._base)
                continue
            if not there:
                faults.append(self._describe_missing(part, asked[0], kinds))
                continue
            topic = there[0]
            fitting = [kind for kind in self._offered[topic] if kind in kinds]
            if fitting:
                found[part], self._types[topic] = topic, fitting[0]
            else:
                other = one_of(self._offered[topic])
                faults.append(f"{topic} is of {other}, and {part} is read from {one_of(kinds)}")
        for part, past in self._past.items():
            if self._types.get(found.get(past.lidar, "")) != SCAN and not faults:
                faults.append(self._describe_missing(part, f"/{self._prefix}observation/{part}", ()))
        if faults:
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            raise ConfigError(f"{self._origin}: {faults[0]}{more}")
        return found

    def _describe_missing(self, part: str, topic: str, kinds: Sequence[str]) -> str:
        # Any array could be meant, but one that is called after another part is not.
        named = [kind for kind in kinds if kind not in _ARRAY_NAMES]
        fits = [name for name, found in sorted(self._offered.items()) if not {*found}.isdisjoint(named)]
        lacks = f"there is no topic {topic} for {part}"
        if not fits:
            others = f", nor another of {one_of(named)}" if named else ""
            return f"{lacks}{others}; {self._remedy}"
        robots = [name for name in self._robots() if not self._prefix]
        remedy = f"robot={robots[0]} or " if robots else ""
        return f"{lacks}; set {remedy}topics.{part}=TOPIC, such as {one_of(fits[:_SHOWN])}"

    def _robots(self) -> list[str]:
        """The namespaces of robots of ours."""
        ends = [name.removesuffix(_TRUTH) for name in self._offered if name.endswith(_TRUTH)]
        return sorted(name.strip("/") for name in ends if name)

    def type_of(self, topic: str) -> str:
        """The type of a topic that is read."""
        return self._types[topic]

    # -- messages ---------------------------------------------------------------------------------

    def take(self, topic: str, message: Any, time_ns: int) -> None:
        """Take a message that arrived at a time; those of earlier times have been settled."""
        if topic in (TF, TF_STATIC):
            self.frames.add(message, is_static=topic == TF_STATIC)
        for part in self._parts_of.get(topic, ()):
            self._latest[part] = message
            self._new_scans += [
                (past, time_ns, message) for past in self._past.values() if past.lidar == part
            ]

    def settle(self, time_ns: int) -> None:
        """Take note that all messages of before a time have arrived."""
        while self._new_scans and time_ns > self._new_scans[0][1]:
            past, taken_ns, message = self._new_scans.pop(0)
            with self._naming(past.lidar, message):
                past.add(message, taken_ns, self.frames)

    def forget(self) -> None:
        """Drop all messages but the fixed frames: the time of those that follow begins anew."""
        self._latest.clear()
        self._new_scans.clear()
        self.frames.forget_changing()
        for past in self._past.values():
            past.forget()

    @property
    def missing(self) -> list[str]:
        """The topics of which there is no message yet."""
        return [topic for part, topic in self.topics.items() if part not in self._latest]

    def message_of(self, topic: str) -> Any:
        """The latest message of a topic that is read; None before the first."""
        return self._latest.get(self._parts_of[topic][0])

    @property
    def transforms(self) -> list[tuple[str, str]]:
        """The frames that are read from /tf, each with the frame in which its pose is needed."""
        found = [(self._base, f"{self._prefix}{ODOM}")] if self._past else []
        for part, topic in self.topics.items():
            if self._types[topic] == POSE and part in self._latest:
                found.append((self._base, self._latest[part].header.frame_id))
        return found

    def observation(self, time_ns: int) -> dict[str, Reading]:
        """The reading of each part at a time; raises ConfigError for a message that does not fit."""
        found = {}
        for part, message in self._latest.items():
            source = self._parts[part]
            is_array = message.__msgtype__ in _ARRAY_NAMES
            codec = source.array if is_array or source.codec is None else source.codec
            with self._naming(part, message):
                found[part] = codec.decode(part, message, self.frames, self._base)
                if not np.isfinite(found[part]).all():
                    raise MessageError("it has numbers that are not finite")
        for part, past in self._past.items():
            scan = self._latest[past.lidar]
            with self._naming(past.lidar, scan):
                found[part] = past.reading(scan, time_ns, self.frames)
        return found

    @contextmanager
    def _naming(self, part: str, message: Any) -> Iterator[None]:
        """Turns a MessageError into a ConfigError that names the origin, the topic and a message's time."""
        try:
            yield
        except MessageError as error:
            at = ""
            if hasattr(message, "header"):
                at = f" at {stamp_ns(message.header.stamp) / NS_PER_S:.3f} s"
            raise ConfigError(
                f"{self._origin}: {self.topics[part]}{at} does not fit {part}: {error}"
            ) from None

    # -- mounts -----------------------------------------------------------------------------------

    def misplaced(self) -> list[str]:
        """A line for each sensor that is mounted elsewhere than where the policy learnt, by /tf_static."""
        lines = {}
        for part, message in self._latest.items():
            codec = self._parts[part].codec
            if codec is None or not codec.mounts or message.__msgtype__ in _ARRAY_NAMES:
                continue
            frame = message.header.frame_id
            is_known = bool(frame) and self.frames.pose(frame, self._base) is not None
            if is_known and (line := self._describe_mount(part, codec.mounts, frame)):
                lines[self.topics[part]] = line
        return list(lines.values())

    def _describe_mount(self, part: str, mounts: tuple[FrameMount, ...], frame: str) -> str:
        """What is wrong with the place of a sensor, whose frames the policy knows as `mounts`; else empty."""
        pose = self.frames.pose(frame, self._base)
        assert pose is not None
        # From the body outwards.
        learnt = reduce(matmul, (mount.pose for mount in mounts))
        topic, turned = self.topics[part], learnt.rotation.T @ pose.rotation
        # The bearings of scans are turned back; what is left is the tilt.
        cosine = turned[2, 2] if self._types[topic] == SCAN else (np.trace(turned) - 1.0) / 2.0
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        if np.linalg.norm(pose.position - learnt.position) > _MOST_OFFSET_M:
            sensor = mounts[0].name.removesuffix("_link")
            here, there = (
                f"[{','.join(f'{value:.3g}' for value in each.position)}]" for each in (pose, learnt)
            )
            return (
                f"{topic}: {frame} is at {here} m on {self._base}, and the policy learnt with {sensor} at "
                f"{there}; mount it there, or train with sensors.{sensor}.mount_b={here}"
            )
        if angle > _MOST_TURN_RAD:
            return (
                f"{topic}: {frame} is turned by {np.rad2deg(angle):.0f} degrees from where the policy learnt "
                "with its sensor; mount it so, or correct its frame in /tf_static"
            )
        return ""
