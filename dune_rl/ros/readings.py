"""Readings of a robot out of a bag: the latest of each sensor at the times at which a policy decides."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import one_of
from dune_rl.ros.bag import read_told
from dune_rl.ros.codecs import ARRAYS, ArrayCodec, MessageError, SensorCodec, Source
from dune_rl.ros.library import full_name, message_types, require_rosbags, stamp_ns
from dune_rl.ros.past_scans import PastScans
from dune_rl.ros.transforms import BASE, ODOM, TransformTree
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.sensor import Reading

_NS = 1_000_000_000
# A message that is logged so much later than a decision still counts: times of bags are rounded.
_TOLERANCE_NS = 1_000
_TF, _TF_STATIC = "/tf", "/tf_static"
_TRUTH = "/ground_truth/odom"
_SCAN = "sensor_msgs/msg/LaserScan"
_ARRAY_NAMES = tuple(map(full_name, ARRAYS))
_SHOWN = 6


@dataclass(frozen=True)
class ReadingSource:
    """A part of an observation: its shape and type, and the codec of its sensor; None for an array's.

    `past` is the name of the LiDAR, its settings and the age [s] of a part that is a past scan: without a
    topic of its own, it follows from the LiDAR's scans.
    """

    array: ArrayCodec
    codec: SensorCodec | None = None
    past: tuple[str, LidarConf, float] | None = None

    def sources(self, part: str) -> tuple[Source, ...]:
        """Where it may come from, the standard message first."""
        found = [] if self.codec is None else [self.codec.sources[part]]
        return (*found, *(each for each in (self.array.sources[part],) if each not in found))


class BagReadings:
    """The readings `parts` of one robot in a bag (rosbag2: a folder, an .mcap or a .db3 file).

    `robot` is the namespace of its topics and frames, `base` the frame of its body. `topics` names the topics
    of parts that are not the default ones. Raises ConfigError, which says which topic is
    missing or does not fit.
    """

    def __init__(
        self,
        path: Path,
        parts: Mapping[str, ReadingSource],
        topics: Mapping[str, str],
        *,
        robot: str | None = None,
        base: str | None = None,
    ) -> None:
        require_rosbags("reading bags")
        self._path, self._parts = path, dict(parts)
        self._prefix = "" if robot is None else f"{robot.strip('/')}/"
        self._base = base or f"{self._prefix}{BASE}"
        with _opened(path) as reader:
            self._types = {connection.topic: connection.msgtype for connection in reader.connections}
            self._counts = {topic: info.msgcount for topic, info in reader.topics.items()}
            self.told = read_told(reader)
        self._past: dict[str, tuple[str, PastScans]] = {}
        self._topics = self._choose_topics(topics)

    def _choose_topics(self, named: Mapping[str, str]) -> dict[str, str]:
        """The topic of each part; raises ConfigError for all that are missing or of another type."""
        unknown = [name for name in named if name not in self._parts]
        if unknown:
            raise ConfigError(
                f"topics.{unknown[0]}: the policy reads no {unknown[0]}, but {one_of(sorted(self._parts))}"
            )
        found, faults = {}, []
        for part, each in self._parts.items():
            sources = each.sources(part)
            kinds = [full_name(kind) for source in sources for kind in source.types]
            defaults = [f"/{self._prefix}{source.topic}" for source in sources]
            asked = [named[part]] if part in named else defaults
            there = [topic for topic in asked if self._counts.get(topic)]
            if not there and each.past is not None and part not in named:
                lidar, conf, past_s = each.past
                self._past[part] = lidar, PastScans(conf, past_s, f"{self._prefix}{ODOM}", self._base)
            elif not there:
                faults.append(self._describe_missing(part, asked[0], kinds))
            elif self._types[there[0]] not in kinds:
                faults.append(
                    f"{there[0]} is of {self._types[there[0]]}, and {part} is read from {one_of(kinds)}"
                )
            else:
                found[part] = there[0]
        for part, (lidar, _) in self._past.items():
            if self._types.get(found.get(lidar, "")) != _SCAN and not faults:
                faults.append(self._describe_missing(part, f"/{self._prefix}observation/{part}", ()))
        if faults:
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            raise ConfigError(f"{self._path}: {faults[0]}{more}")
        return found

    def _describe_missing(self, part: str, topic: str, kinds: Sequence[str]) -> str:
        # Any array could be meant, but one that is called after another part is not.
        named = [kind for kind in kinds if kind not in _ARRAY_NAMES]
        fits = [name for name, kind in sorted(self._types.items()) if kind in named and self._counts[name]]
        lacks = f"there is no topic {topic} for {part}"
        if not fits:
            others = f", nor another of {one_of(named)}" if named else ""
            return f"{lacks}{others}; record one"
        robots = [name for name in self._robots() if not self._prefix]
        remedy = f"robot={robots[0]} or " if robots else ""
        return f"{lacks}; set {remedy}topics.{part}=TOPIC, such as {one_of(fits[:_SHOWN])}"

    def _robots(self) -> list[str]:
        """The namespaces of robots in a bag of ours."""
        ends = [name.removesuffix(_TRUTH) for name in self._types if name.endswith(_TRUTH)]
        return sorted(name.strip("/") for name in ends if name)

    def decisions(self, period_s: float) -> Iterator[tuple[int, dict[str, Reading]]]:
        """Times [ns] every `period_s`, and the readings of each part that have arrived by then.

        The first is when all parts have arrived, the last one before the last message of any.
        """
        first_ns, last_ns = self._extent()
        frames = self._static_frames()
        latest: dict[str, Any] = {}
        by_topic: dict[str, list[str]] = {}
        for part, topic in self._topics.items():
            by_topic.setdefault(topic, []).append(part)
        number = 0
        # Scans that wait for the frames of their time, which may come after them.
        new_scans: list[tuple[str, int, Any]] = []
        for topic, time_ns, message in self._messages({*by_topic, _TF}):
            if new_scans and time_ns > new_scans[0][1]:
                self._keep_scans(new_scans, frames)
                new_scans.clear()
            until_ns = min(last_ns, time_ns - _TOLERANCE_NS)
            while (due_ns := first_ns + round(number * period_s * _NS)) < until_ns:
                yield due_ns, self._decode(latest, frames) | self._past_scans(latest, due_ns, frames)
                number += 1
            if topic == _TF:
                frames.add(message)
            for part in by_topic.get(topic, ()):
                latest[part] = message
                new_scans += [
                    (name, time_ns, message) for name, (lidar, _) in self._past.items() if lidar == part
                ]

    def _keep_scans(self, scans: Sequence[tuple[str, int, Any]], frames: TransformTree) -> None:
        for part, time_ns, message in scans:
            lidar, past = self._past[part]
            with self._naming(lidar, message):
                past.add(message, time_ns, frames)

    def _past_scans(
        self, latest: Mapping[str, Any], time_ns: int, frames: TransformTree
    ) -> dict[str, Reading]:
        found = {}
        for part, (lidar, past) in self._past.items():
            with self._naming(lidar, latest[lidar]):
                found[part] = past.reading(latest[lidar], time_ns, frames)
        return found

    @contextmanager
    def _naming(self, part: str, message: Any) -> Iterator[None]:
        """Turns a MessageError into a ConfigError that names the bag, the topic and the time of a message."""
        try:
            yield
        except MessageError as error:
            at = ""
            if hasattr(message, "header"):
                at = f" at {stamp_ns(message.header.stamp) / _NS:.3f} s"
            raise ConfigError(
                f"{self._path}: {self._topics[part]}{at} does not fit {part}: {error}"
            ) from None

    def _decode(self, latest: Mapping[str, Any], frames: TransformTree) -> dict[str, Reading]:
        found = {}
        for part, message in latest.items():
            source = self._parts[part]
            is_array = message.__msgtype__ in _ARRAY_NAMES
            codec = source.array if is_array or source.codec is None else source.codec
            with self._naming(part, message):
                found[part] = codec.decode(part, message, frames, self._base)
        return found

    def _extent(self) -> tuple[int, int]:
        """When the last of the parts has its first message, and the last message of any [ns]."""
        first: dict[str, int] = {}
        last = 0
        with _opened(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic in self._topics.values()]
            for connection, time_ns, _ in self._records(reader, chosen):
                first.setdefault(connection.topic, time_ns)
                last = max(last, time_ns)
        if lost := sorted({*self._topics.values()} - first.keys()):
            raise ConfigError(
                f"bag={self._path} is damaged (no message of {lost[0]}); copy or record it again"
            )
        return max(first.values()), last

    def _static_frames(self) -> TransformTree:
        frames = TransformTree()
        for _, _, message in self._messages({_TF_STATIC}):
            frames.add(message)
        return frames

    def _records(self, reader: Any, chosen: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """What a bag has of `chosen` connections; raises ConfigError where it is damaged."""
        try:
            # Of no connection, the library means all.
            yield from reader.messages(chosen) if chosen else ()
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ConfigError(f"bag={self._path} is damaged ({reason}); copy or record it again") from None

    def _messages(self, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time [ns] and message of what the bag has of `topics`, in order of time."""
        store = message_types().store
        with _opened(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic in topics]
            for connection, time_ns, data in self._records(reader, chosen):
                try:
                    message = store.deserialize_cdr(data, connection.msgtype)
                except Exception as error:
                    raise ConfigError(
                        f"{self._path}: a message of {connection.topic} ({connection.msgtype}) cannot be "
                        f"read: {' '.join(str(error).split())}"
                    ) from None
                yield connection.topic, time_ns, message


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of a bag; raises ConfigError where there is none."""
    from rosbags.rosbag2 import Reader

    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:
        reason = " ".join(str(error).split())
        raise ConfigError(
            f"bag={path} is no bag that can be read ({reason}); give a rosbag2 folder, an .mcap or a "
            ".db3 file"
        ) from None
    try:
        yield reader
    finally:
        reader.close()
