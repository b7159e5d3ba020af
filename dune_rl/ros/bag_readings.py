"""Readings of a robot out of a bag: the latest of each sensor at the times at which a policy decides."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.ros.bag import read_metadata
from dune_rl.ros.library import message_types, require_rosbags
from dune_rl.ros.readings import POSE, TF, TF_STATIC, ReadingSource, RobotReadings
from dune_rl.ros.settings import MOST_AGE_S
from dune_rl.ros.times import NS_PER_S
from dune_rl.sensors.sensor import Reading

# A message that is logged so much later than a decision still counts: times of bags are rounded.
_TOLERANCE_NS = 1_000
_METADATA = "metadata.yaml"


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
        self._path = path
        with _open_bag(path) as reader:
            counts = {topic: info.msgcount for topic, info in reader.topics.items()}
            types = {each.topic: [each.msgtype] for each in reader.connections if counts[each.topic]}
            self.metadata = read_metadata(reader)
        self._readings = RobotReadings(
            parts, types, topics, origin=str(path), remedy="record one", robot=robot, base=base
        )
        # When the last message of each topic came, and its longest silence at a decision: length, start [ns].
        self._arrived_ns: dict[str, int] = {}
        self._silences: dict[str, tuple[int, int]] = {}

    def decisions(self, period_s: float) -> Iterator[tuple[int, dict[str, Reading]]]:
        """Times [ns] every `period_s`, and the readings of each part that have arrived by then.

        The first is when all parts have arrived, the last one before the last message of any.
        """
        readings = self._readings
        first_ns, last_ns = self._extent()
        for topic, _, message in self._messages({TF_STATIC}):
            readings.take(topic, message, 0)
        number = 0
        for topic, time_ns, message in self._messages({*readings.topics.values(), TF}):
            readings.settle(time_ns)
            until_ns = min(last_ns, time_ns - _TOLERANCE_NS)
            while (due_ns := first_ns + round(number * period_s * NS_PER_S)) < until_ns:
                self._note_silences(due_ns)
                yield due_ns, readings.observation(due_ns)
                number += 1
            readings.take(topic, message, time_ns)
            self._arrived_ns[topic] = time_ns

    def _note_silences(self, now_ns: int) -> None:
        for topic, arrived_ns in self._arrived_ns.items():
            silence = now_ns - arrived_ns, arrived_ns
            self._silences[topic] = max(silence, self._silences.get(topic, silence))

    def silent(self) -> list[str]:
        """A line for each topic that was silent for so long that a robot on live topics would have stood."""
        continuous = [
            topic for topic in self._readings.topics.values() if self._readings.type_of(topic) != POSE
        ]
        if self._readings.transforms:
            continuous.append(TF)
        silences = {topic: self._silences[topic] for topic in continuous if topic in self._silences}
        return [
            f"{topic}: no message for {silent_ns / NS_PER_S:.2f} s from {since_ns / NS_PER_S:.2f} s on; "
            "the actions are of its last one, and live the robot would stand"
            for topic, (silent_ns, since_ns) in silences.items()
            if silent_ns > MOST_AGE_S * NS_PER_S
        ]

    def misplaced(self) -> list[str]:
        """See `RobotReadings.misplaced`; after the last decision."""
        return self._readings.misplaced()

    def _extent(self) -> tuple[int, int]:
        """When the last of the parts has its first message, and the last message of any [ns]."""
        first: dict[str, int] = {}
        last = 0
        with _open_bag(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic in self._readings.topics.values()]
            for connection, time_ns, _ in self._records(reader, chosen):
                first.setdefault(connection.topic, time_ns)
                last = max(last, time_ns)
        if lost := sorted({*self._readings.topics.values()} - first.keys()):
            raise self._damage(f"no message of {lost[0]}")
        return max(first.values()), last

    def _records(self, reader: Any, chosen: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """What a bag has of `chosen` connections; raises ConfigError where it is damaged."""
        try:
            # Of no connection, the library means all.
            yield from reader.messages(chosen) if chosen else ()
        except Exception as error:
            raise self._damage(_one_line(error)) from None

    def _damage(self, reason: str) -> ConfigError:
        return ConfigError(f"bag={self._path} is damaged ({reason}); copy or record it again")

    def _messages(self, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time [ns] and message of what the bag has of `topics`, in order of time."""
        store = message_types().store
        with _open_bag(self._path) as reader:
            chosen = [each for each in reader.connections if each.topic in topics]
            for connection, time_ns, data in self._records(reader, chosen):
                try:
                    message = store.deserialize_cdr(data, connection.msgtype)
                except Exception as error:
                    raise ConfigError(
                        f"{self._path}: a message of {connection.topic} ({connection.msgtype}) cannot be "
                        f"read: {_one_line(error)}"
                    ) from None
                yield connection.topic, time_ns, message


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@contextmanager
def _open_bag(path: Path) -> Iterator[Any]:
    """A reader of a bag; raises ConfigError where there is none."""
    from rosbags.rosbag2 import Reader

    if not (path / _METADATA).exists():
        # An evaluation writes FOLDER/POLICY/episode_NUMBER.
        inside = sorted([*path.glob(f"*/{_METADATA}"), *path.glob(f"*/*/{_METADATA}")])
        if inside:
            raise ConfigError(f"bag={path} is a folder of bags; give one, such as bag={inside[0].parent}")
        files = sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
        if files:
            raise ConfigError(f"bag={path} has no {_METADATA}; give the file in it, bag={files[0]}")
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:
        raise ConfigError(
            f"bag={path} is no bag that can be read ({_one_line(error)}); give a rosbag2 folder, an .mcap or "
            "a .db3 file"
        ) from None
    try:
        yield reader
    finally:
        reader.close()
