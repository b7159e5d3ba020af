"""Topics within a test, in place of a network: what is written is kept, and what is read was put there."""

import os
import random
from typing import Any

from dune_rl.ros.dds import Offer, Received
from dune_rl.ros.library import full_name, message_types


def random_domain() -> int:
    """A domain that no other test of this run has; below those whose ports Linux lends to others."""
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    share = 99 // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return 1 + number * share + random.SystemRandom().randrange(share)


class TopicBoard:
    """A `Participant` without a network."""

    def __init__(self) -> None:
        self.types = message_types()
        self.written: dict[str, list[Any]] = {}
        self.latched: set[str] = set()
        self.offered: dict[str, list[Offer]] = {}
        self._waiting: dict[tuple[str, str], list[Received]] = {}
        self._time_ns = 1

    # -- what the program under test calls ---------------------------------------------------------

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        self.written.setdefault(topic, []).append(message)
        if latched:
            self.latched.add(topic)

    def advertise(self, topic: str, kind: str, *, latched: bool = False) -> None:
        self.written.setdefault(topic, [])

    @property
    def published(self) -> list[str]:
        return sorted(self.written)

    def subscribe(self, topic: str, kind: str, **qos: bool) -> "_Waiting":
        return _Waiting(self._waiting.setdefault((topic, kind), []))

    def wait(self, timeout_s: float) -> None:
        pass

    def flush(self, timeout_s: float) -> None:
        pass

    def offers(self) -> dict[str, list[Offer]]:
        return self.offered

    # -- what the test does ------------------------------------------------------------------------

    def offer(self, topic: str, kind: str) -> None:
        self.offered[topic] = [Offer(full_name(kind), True, False)]

    def put(self, topic: str, message: Any) -> None:
        """Let a message arrive."""
        self._time_ns += 1
        received = Received(message, self._time_ns)
        self._waiting.setdefault((topic, message.__msgtype__), []).append(received)

    def last(self, topic: str) -> Any:
        return self.written[topic][-1]


class _Waiting:
    damaged = 0

    def __init__(self, messages: list[Received]) -> None:
        self._messages = messages

    def take(self) -> list[Received]:
        found = [*self._messages]
        self._messages.clear()
        return found
