"""Readings of a robot out of live topics, and why they cannot be acted upon."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.ros.dds import Offer, Participant, Subscription
from dune_rl.ros.library import full_name
from dune_rl.ros.readings import POSE, TF, TF_STATIC, ReadingSource, RobotReadings, check_parts
from dune_rl.ros.settings import DrivingConf
from dune_rl.ros.times import NS_PER_S, header_ns, stamp_ns
from dune_rl.sensors.sensor import Reading

_CLOCK, _CLOCK_TYPE = "/clock", full_name("rosgraph_msgs/Clock")
_TF_TYPE = full_name("tf2_msgs/TFMessage")
# Topics become known one after another: what is there twice, so long apart, is all [s].
_LOOK_S = 0.3
# A simulation's clock that does not tick for so long, in real time, stands still [s].
_LEAST_TICK_S = 1.0


class StoppedWaitingError(Exception):
    """The wait for topics was stopped."""


class LiveReadings:
    """The readings `parts` of one robot on the topics of `participant`; see `RobotReadings` for the others.

    Their time is that of /clock, where it is published and `conf.sim_time` is not false, and else this
    machine's. Raises ConfigError where a topic is missing after `conf.wait_s`, or does not fit, and
    StoppedWaitingError where it `is_stopped` before.
    """

    def __init__(
        self,
        participant: Participant,
        parts: Mapping[str, ReadingSource],
        topics: Mapping[str, str],
        conf: DrivingConf,
        *,
        origin: str,
        is_stopped: Callable[[], bool],
        robot: str | None = None,
        base: str | None = None,
    ) -> None:
        check_parts(topics, parts)
        self._participant, self._conf, self._origin = participant, conf, origin
        self._make = lambda types: RobotReadings(
            parts, types, topics, origin=origin, remedy="start what publishes one", robot=robot, base=base
        )
        offers = self._find_topics(is_stopped)
        self._subscriptions: dict[str, Subscription] = {}
        for topic in {*self._readings.topics.values()}:
            self._subscribe(topic, self._readings.type_of(topic), offers)
        self._subscribe(TF, _TF_TYPE, offers)
        self._subscriptions[TF_STATIC] = participant.subscribe(
            TF_STATIC, _TF_TYPE, reliable=True, latched=True
        )
        self._has_clock = conf.sim_time is not False and _CLOCK in offers
        if self._has_clock:
            self._subscribe(_CLOCK, _CLOCK_TYPE, offers)
        # None before the first tick.
        self._clock_ns: int | None = None
        self._ticked_s = time.monotonic()
        # When the last message of each topic arrived, by the clock, and what came since its last tick.
        self._arrived_ns: dict[str, int] = {}
        self._since_tick: dict[str, Any] = {}
        self.newest_sent_ns = 0

    def _find_topics(self, is_stopped: Callable[[], bool]) -> Mapping[str, list[Offer]]:
        """Choose the topics, when there are all of them; returns what is offered."""
        until_s, before = time.monotonic() + self._conf.wait_s, None
        while True:
            time.sleep(min(_LOOK_S, self._conf.wait_s))
            if is_stopped():
                raise StoppedWaitingError
            offers = self._participant.offers()
            is_late = time.monotonic() >= until_s
            try:
                if self._conf.sim_time and _CLOCK not in offers:
                    raise ConfigError(f"{self._origin}: there is no topic /clock; leave sim_time=true out")
                types = {topic: [offer.type for offer in found] for topic, found in offers.items()}
                self._readings = self._make(types)
            except ConfigError:
                if is_late and not offers:
                    raise ConfigError(
                        f"{self._origin}: nobody publishes a topic; start the robot, or set domain=N or "
                        "network=NAME to where it is"
                    ) from None
                if is_late:
                    raise
                continue
            if is_late or self._readings.topics == before:
                return offers
            before = self._readings.topics

    def _subscribe(self, topic: str, kind: str, offers: Mapping[str, list[Offer]]) -> None:
        found = [offer for offer in offers.get(topic, ()) if offer.type == kind]
        self._subscriptions[topic] = self._participant.subscribe(
            topic,
            kind,
            reliable=bool(found) and found[0].reliable,
            latched=bool(found) and found[0].reliable and found[0].latched,
        )

    # -- time -------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """The time [ns] of the clock; 0 before its first tick."""
        return self._clock_ns or 0 if self._has_clock else time.time_ns()

    @property
    def clock_stands(self) -> bool:
        """Whether the clock of a simulation does not tick."""
        stood_s = time.monotonic() - self._ticked_s
        return self._has_clock and stood_s > max(_LEAST_TICK_S, self._conf.max_age_s)

    # -- messages ---------------------------------------------------------------------------------

    def poll(self, timeout_s: float) -> None:
        """Take the messages that have arrived; wait for one, at most `timeout_s`."""
        self._participant.wait(timeout_s)
        found: list[tuple[int, str, Any]] = [
            (received.sent_ns, topic, received.message)
            for topic, subscription in self._subscriptions.items()
            for received in subscription.take()
        ]
        for sent_ns, topic, message in sorted(found, key=lambda each: each[0]):
            if topic == _CLOCK:
                self._tick(stamp_ns(message.clock))
                continue
            self._take(topic, message)
            if self._has_clock:
                self._since_tick[topic] = message
            if topic != TF_STATIC and not self._is_event(topic):
                self.newest_sent_ns = max(self.newest_sent_ns, sent_ns)
        if any(topic == _CLOCK for _, topic, _ in found):
            # Now: the first messages take a while.
            self._ticked_s = time.monotonic()

    def _take(self, topic: str, message: Any) -> None:
        self._arrived_ns[topic] = self.now_ns
        self._readings.take(topic, message, header_ns(message) or self.now_ns)

    def _tick(self, time_ns: int) -> None:
        if self._clock_ns is None:
            # Of what arrived before, no time was known.
            self._arrived_ns = dict.fromkeys(self._arrived_ns, time_ns)
        elif time_ns < self._clock_ns:
            # A simulation has begun anew, and may have published before it ticked.
            self._arrived_ns.clear()
            self._readings.forget()
            self._clock_ns = time_ns
            for topic, message in self._since_tick.items():
                if (header_ns(message) or 0) <= time_ns:
                    self._take(topic, message)
        self._clock_ns = time_ns
        self._since_tick.clear()

    def _is_event(self, topic: str) -> bool:
        """Whether a topic has a message when something happens, such as a goal, and not all the time."""
        return topic not in (TF, TF_STATIC) and self._readings.type_of(topic) == POSE

    def fault(self) -> str:
        """Why nothing can be done now: a topic that is missing or has stopped; empty where there is all."""
        if missing := self._readings.missing:
            return f"{missing[0]}: no message yet{self._hint(missing[0])}"
        if self._has_clock and self._clock_ns is None:
            return f"{_CLOCK}: no message yet"
        if self.clock_stands:
            return f"{_CLOCK} stands still"
        for topic in {*self._readings.topics.values()}:
            if not self._is_event(topic) and (fault := self._age_fault(topic)):
                return fault
        for frame, reference in self._readings.transforms:
            oldest_ns = self._readings.frames.oldest_ns(frame, reference)
            if oldest_ns is not None and self.now_ns - oldest_ns > self._conf.max_age_s * NS_PER_S:
                age_s = (self.now_ns - oldest_ns) / NS_PER_S
                return f"{TF}: the last pose of {frame} in {reference} is {age_s:.2f} s old"
        return ""

    def _age_fault(self, topic: str) -> str:
        most_ns, now_ns = round(self._conf.max_age_s * NS_PER_S), self.now_ns
        silent_ns = now_ns - self._arrived_ns.get(topic, now_ns)
        if silent_ns > most_ns:
            return f"{topic}: no message for {silent_ns / NS_PER_S:.2f} s{self._hint(topic)}"
        stamp = header_ns(self._readings.message_of(topic))
        if stamp is None or abs(now_ns - stamp) <= most_ns:
            return ""
        side = "behind" if stamp < now_ns else "ahead of"
        whose = _CLOCK if self._has_clock else "this machine's clock"
        advice = "synchronise the clocks, or set max_age_s=S"
        if not self._has_clock and _CLOCK in self._participant.offers():
            advice = f"there is a {_CLOCK}: leave sim_time=false out"
        return f"{topic}: stamps are {abs(now_ns - stamp) / NS_PER_S:.2f} s {side} {whose}; {advice}"

    def _hint(self, topic: str) -> str:
        """What others publish in place of the messages that a topic should have."""
        kinds = [offer.type for offer in self._participant.offers().get(topic, ())]
        if not kinds:
            return "; nobody publishes it"
        if self._readings.type_of(topic) not in kinds:
            return f"; it is published as {kinds[0]} now"
        damaged = self._subscriptions[topic].damaged
        return f"; {damaged} damaged messages were left out" if damaged else ""

    def observation(self) -> dict[str, Reading]:
        """The latest reading of each part; raises ConfigError for a message that does not fit."""
        self._readings.settle(self.now_ns)
        return self._readings.observation(self.now_ns)

    def misplaced(self) -> list[str]:
        """See `RobotReadings.misplaced`."""
        return self._readings.misplaced()
