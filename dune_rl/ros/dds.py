"""Topics of ROS 2 over DDS, by Eclipse Cyclone DDS and without ROS."""

import socket
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

from dune_rl.core.errors import ConfigError
from dune_rl.ros.dds_types import dds_topic, message_struct, require_live_topics, ros_topic, ros_type
from dune_rl.ros.library import MessageTypes, message_types
from dune_rl.ros.settings import MOST_PARTICIPANTS, NetworkConf
from dune_rl.ros.times import NS_PER_S

# A writer waits so long for readers that are behind; then the message is left out.
_WAIT_NS = 100_000_000
# Messages of a topic that are kept, as by default in ROS 2, and of one that is read: more than arrive between
# two looks.
_KEPT, _READ = 10, 100


@dataclass(frozen=True)
class Offer:
    """A topic that others publish: its type, and the quality of service that all of them offer."""

    type: str
    reliable: bool
    latched: bool


@dataclass(frozen=True)
class Received:
    """A message, and the time [ns] since 1970 at which its publisher wrote it."""

    message: Any
    sent_ns: int


class Subscription:
    """The messages of one topic, as they arrive."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self.damaged = 0

    def take(self) -> list[Received]:
        """The messages that have arrived since the last call, the oldest first; `damaged` counts others."""
        samples = [sample for sample in self._reader.take(_READ) if sample.sample_info.valid_data]
        whole = [
            Received(sample.message, sample.sample_info.source_timestamp)
            for sample in samples
            if sample.message is not None
        ]
        self.damaged += len(samples) - len(whole)
        return whole


class _OpenDomain:
    """A domain with its configuration, which the participants of a process share."""

    def __init__(self, number: int, xml: str) -> None:
        from cyclonedds.domain import Domain

        self.xml, self._domain = xml, Domain(number, xml)


_DOMAINS: WeakValueDictionary[int, _OpenDomain] = WeakValueDictionary()


class Participant:
    """Publishes and reads topics of ROS 2: names, types, encodings and qualities of service are ROS 2's.

    Raises ConfigError where the packages are missing or the network cannot be used.
    """

    def __init__(self, conf: NetworkConf) -> None:
        require_live_topics()
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import (
            DDSException,
            InstanceState,
            ReadCondition,
            SampleState,
            ViewState,
            WaitSet,
        )
        from cyclonedds.domain import DomainParticipant

        self.types: MessageTypes = message_types()
        _check_peers(conf.peers)
        try:
            self._domain = _open_domain(conf)
            self._participant = DomainParticipant(conf.domain_id)
        except DDSException:
            raise ConfigError(
                f"{conf.where} cannot be used: there is no such network, or its ports are taken, by "
                f"{MOST_PARTICIPANTS} programs in the domain or by others; set domain=N or network=INTERFACE"
            ) from None
        self._waiting = WaitSet(self._participant)
        self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        state = InstanceState.Alive | SampleState.Any | ViewState.Any
        self._alive = ReadCondition(self._publications, state)
        self._writers: dict[str, Any] = {}
        self._conditions: list[Any] = []

    # -- to others --------------------------------------------------------------------------------

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Publish a message of `topic`; a `latched` one is kept for those who come later.

        `time_ns` is for bags. A message for which readers have no room in time is left out.
        """
        from cyclonedds.core import DDSException

        writer = self._writers.get(topic) or self.advertise(topic, message.__msgtype__, latched=latched)
        if not latched and not writer.get_publication_matched_status().current_count:
            return
        try:
            writer.write(message_struct(message.__msgtype__)(message))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise

    def advertise(self, topic: str, kind: str, *, latched: bool = False) -> Any:
        """Let others know that messages of the type `kind` will be published on `topic`."""
        from cyclonedds.pub import DataWriter

        qos = self._qos(kind, 1 if latched else _KEPT, latched=latched)
        writer = DataWriter(self._participant, self._topic(topic, kind), qos=qos)
        self._writers[topic] = writer
        return writer

    @property
    def published(self) -> list[str]:
        """The topics that are published here."""
        return sorted(self._writers)

    def flush(self, timeout_s: float) -> None:
        """Wait until readers have what was published, at most `timeout_s`."""
        from cyclonedds.core import DDSException

        for writer in self._writers.values():
            try:
                writer.wait_for_acks(round(timeout_s * NS_PER_S))
            except (DDSException, AttributeError):
                # Readers that are gone; the library fails to say so.
                continue

    # -- from others ------------------------------------------------------------------------------

    def subscribe(
        self, topic: str, kind: str, *, reliable: bool = False, latched: bool = False
    ) -> Subscription:
        """Read the messages of the type `kind` on `topic`, by default those of every other participant.

        With `reliable` or `latched` only those of publishers that offer this.
        """
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        qos = self._qos(kind, _READ, reliable=reliable, latched=latched)
        reader = DataReader(self._participant, self._topic(topic, kind), qos=qos)
        condition = ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead)
        self._waiting.attach(condition)
        self._conditions.append(condition)
        return Subscription(reader)

    def wait(self, timeout_s: float) -> None:
        """Wait until there is a message of any topic that is read, at most `timeout_s`."""
        self._waiting.wait(max(round(timeout_s * NS_PER_S), 0))

    def offers(self) -> dict[str, list[Offer]]:
        """What others publish now, by topic, the types in order of their names."""
        found: dict[str, dict[str, Offer]] = {}
        for topic, kind, reliable, latched in self._publishers():
            of_topic = found.setdefault(topic, {})
            before = of_topic.get(kind, Offer(kind, True, True))
            of_topic[kind] = Offer(kind, before.reliable and reliable, before.latched and latched)
        return {topic: [kinds[kind] for kind in sorted(kinds)] for topic, kinds in found.items()}

    def _publishers(self) -> Iterator[tuple[str, str, bool, bool]]:
        """Topic, type, and whether it is reliable and latched, of each publisher but our own."""
        from cyclonedds.core import Policy

        own = self._participant.guid
        for endpoint in self._publications.read(10_000, self._alive):
            topic = ros_topic(endpoint.topic_name)
            if topic is None or endpoint.participant_key == own:
                continue
            qos = endpoint.qos
            reliable = isinstance(qos[Policy.Reliability], Policy.Reliability.Reliable)
            latched = qos[Policy.Durability] not in (None, Policy.Durability.Volatile)
            yield topic, ros_type(endpoint.type_name), reliable, latched

    def close(self) -> None:
        """Leave the domain."""
        self._conditions.clear()
        self._writers.clear()
        del self._waiting, self._alive, self._publications, self._participant, self._domain

    # -- both ways --------------------------------------------------------------------------------

    def _topic(self, topic: str, kind: str) -> Any:
        from cyclonedds.core import DDSException
        from cyclonedds.topic import Topic

        try:
            return Topic(self._participant, dds_topic(topic), message_struct(kind))
        except DDSException as error:
            raise ConfigError(f"{topic} cannot be a topic of {kind}: {error.msg or error}") from None

    def _qos(self, kind: str, depth: int, *, reliable: bool = True, latched: bool) -> Any:
        from cyclonedds.core import Policy, Qos

        return Qos(
            Policy.Reliability.Reliable(_WAIT_NS) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(depth),
            # A publisher that leaves takes no messages with it.
            Policy.WriterDataLifecycle(autodispose=False),
            # CDR of the first version, the encoding of ROS 2.
            Policy.DataRepresentation(use_cdrv0_representation=True),
            # Where later releases of ROS 2 look for the version of the type.
            Policy.Userdata(f"typehash={self.types.store.hash_rihs01(kind)};".encode()),
            # What it publishes is not for itself, such as goals.
            Policy.IgnoreLocal.Participant,
        )


def _check_peers(peers: Iterable[str]) -> None:
    """Raise ConfigError for a peer without an IPv4 address, at which Cyclone DDS aborts the process."""
    for peer in peers:
        host, colon, port = peer.partition(":")
        try:
            if colon and not (port.isdecimal() and 0 < int(port) < 1 << 16):
                raise ConfigError(f"peers: {peer} is no HOST or HOST:PORT of IPv4")
            socket.getaddrinfo(host, None, socket.AF_INET)
        except OSError:
            raise ConfigError(
                f"peers: no machine {host} is known; give an IPv4 address, such as 192.168.1.20"
            ) from None


def _open_domain(conf: NetworkConf) -> _OpenDomain:
    number, xml = conf.domain_id, conf.xml()
    domain = _DOMAINS.get(number)
    if domain is None:
        domain = _DOMAINS[number] = _OpenDomain(number, xml)
    elif domain.xml != xml:
        raise ConfigError(f"domain {number} is in use in this process with another network; set domain=N")
    return domain
