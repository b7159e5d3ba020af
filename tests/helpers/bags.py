"""Episodes that are recorded as bags, what was seen meanwhile, and bags with other messages than ours."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.ros.bag import EpisodeBag
from dune_rl.ros.bag_readings import BagReadings
from dune_rl.ros.codecs.codec import ArrayCodec
from dune_rl.ros.group_topics import GroupTopics
from dune_rl.ros.readings import ReadingSource
from dune_rl.ros.recorder import BagRecorder
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState

SHORT = (
    "+world=obstacle_course",
    "actors=none",
    "task.terminations.time_limit.max_steps=8",
    "policy=go_to_goal",
)


@dataclass(frozen=True)
class Seen:
    """What all scenes have after a step: observations (N, ...), the state, the actions that led there."""

    episodes: tuple[int, ...]
    readings: dict[str, dict[str, Reading]]
    states: Mapping[str, GroupState]
    actions: dict[str, np.ndarray]


class Witness:
    """Keeps what is seen beside a recorder."""

    def __init__(self, simulation: Any) -> None:
        self._simulation = simulation
        self.seen: list[Seen] = []

    def begin(self) -> None:
        if not self.seen:
            self._see({})

    def step(self, after: Any) -> None:
        self._see(
            {group.name: after[group.name, "action"].numpy().copy() for group in self._simulation.external}
        )

    def _see(self, actions: dict[str, np.ndarray]) -> None:
        simulation = self._simulation
        readings = {group.name: group.observe() for group in simulation.external}
        episodes = tuple(simulation.episodes.tolist())
        self.seen.append(Seen(episodes, readings, simulation.state.groups, actions))

    def finish(self, rows: Any) -> None:
        pass


class Both:
    def __init__(self, *observers: Any) -> None:
        self._observers = observers

    def begin(self) -> None:
        for each in self._observers:
            each.begin()

    def step(self, after: Any) -> None:
        for each in self._observers:
            each.step(after)

    def finish(self, rows: Any) -> None:
        for each in self._observers:
            each.finish(rows)


@dataclass(frozen=True)
class Recorded:
    """The bags in `folder`, what was seen, and a group's sources of readings, by its name."""

    folder: Path
    seen: list[Seen]
    sources: dict[str, dict[str, ReadingSource]]

    def bag(self, episode: int = 0) -> Path:
        return self.folder / f"episode_{episode}"

    def read(self, episode: int = 0, *, group: str = "rover", period_s: float = 0.05, **more: Any) -> Any:
        found = BagReadings(self.bag(episode), self.sources[group], more.pop("topics", {}), **more)
        return list(found.decisions(period_s))


def record(
    folder: Path,
    *words: str,
    scenes: int = 1,
    episodes: int = 1,
    seed: int = 0,
    policy: str = "go_to_goal",
) -> Recorded:
    """Bags of the first episodes, by default driven straight at their goals."""
    # Another world takes the place of the default one.
    base = SHORT[1:] if any(word.startswith("+world=") for word in words) else SHORT
    conf = compose(EvaluateConf, [*base, *words])
    env = make_learning_env(conf, scenes, seed)
    simulation = simulation_in(env)
    recorder = BagRecorder(simulation, folder, range(episodes), {"decision_s": conf.physics.control_step_s})
    witness = Witness(simulation)
    evaluate(built_in_policy(policy, env), env, episodes, seed, observer=Both(recorder, witness))
    recorder.close()
    sources = {}
    for group in simulation.external:
        topics = GroupTopics(group, conf.physics.control_step_s, conf.physics.action_repeat)
        codecs = {part: codec for codec in topics.codecs.values() for part in codec.sources}
        sources[group.name] = {
            part: ReadingSource(ArrayCodec({part: (low.shape, low.dtype)}), codecs[part])
            for part, (low, _) in group.observation_bounds.items()
        }
    env.close()
    return Recorded(folder, witness.seen, sources)


def read_with_rosbags(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    """Times [ns] and messages by topic, as `rosbags` reads them."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[str, list[tuple[int, Any]]] = {}
    with Reader(bag) as reader:
        for connection, time_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def read_with_mcap(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    """The same as `mcap` and `mcap_ros2` read them, by the definitions that the file has."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list[tuple[int, Any]]] = {}
    with (bag / f"{bag.name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


Change = Callable[[str, Any], Iterable[tuple[str, Any]]]


def rewrite(bag: Path, to: Path, change: Change) -> Path:
    """A bag like `bag`, with what `change` makes of each topic and message."""
    messages = [
        (time_ns, number, topic, message)
        for topic, found in read_with_rosbags(bag).items()
        for number, (time_ns, message) in enumerate(found)
    ]
    changed = [
        (time_ns, pair)
        for time_ns, _, topic, message in sorted(messages, key=lambda each: each[0])
        for pair in change(topic, message)
    ]
    written = EpisodeBag(to, {})
    for time_ns, (topic, message) in changed:
        written.write(topic, message, time_ns)
    written.complete()
    return to
