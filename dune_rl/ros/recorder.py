"""Records episodes as bags: an observer of evaluations."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from dune_rl.env.simulation import VectorSimulation
from dune_rl.ros.agent_recording import AgentRecording
from dune_rl.ros.bag import EpisodeBag, episode_path
from dune_rl.ros.group_topics import GroupTopics
from dune_rl.ros.library import require_rosbags, time_ns_of
from dune_rl.statistics.measures import MetricsRow


class BagRecorder:
    """Writes a bag of each episode of external agents that ends, into `folder`.

    `episodes` are the numbers of those that are run; other scenes rest. With several agents their topics and
    frames have namespaces, their names. `told` is kept in the metadata of each bag, beside its number.
    Times are those of the simulation, from 0 at an episode's start.
    """

    def __init__(
        self, simulation: VectorSimulation, folder: Path, episodes: range, told: Mapping[str, Any]
    ) -> None:
        require_rosbags()
        self._simulation, self._folder, self._episodes, self._told = simulation, folder, episodes, told
        physics = simulation.physics
        self._step_s = physics.control_step_s
        self._groups = [
            GroupTopics(group, self._step_s, physics.action_repeat) for group in simulation.external
        ]
        several = len(simulation.agents) > 1
        self._prefixes = {name: f"{name}/" if several else "" for name in simulation.agents}
        self._bags: dict[int, EpisodeBag] = {}
        self._agents: dict[int, list[list[AgentRecording]]] = {}
        # When each scene's present observation was made [ns].
        self._seen_ns: dict[int, int] = {}

    def begin(self) -> None:
        """Open the bags of scenes that have made no step."""
        for scene in np.flatnonzero(self._simulation.steps == 0).tolist():
            episode = int(self._simulation.episodes[scene])
            if scene in self._bags:
                # Its episode ended without rows: nobody came.
                self._close(scene).discard()
            if episode in self._episodes:
                self._open(scene, episode)
        self._write_states([scene for scene in self._bags if self._simulation.steps[scene] == 0])

    def _open(self, scene: int, episode: int) -> None:
        bag = EpisodeBag(episode_path(self._folder, episode), {**self._told, "episode": episode})
        self._bags[scene] = bag
        self._agents[scene] = [
            [
                AgentRecording(bag, topics, scene * topics.group.count + agent, self._prefixes[name])
                for agent, name in enumerate(topics.group.names)
            ]
            for topics in self._groups
        ]
        types = bag.types
        transforms = [
            types.transform(
                types.header(0, self._prefixes[name] + mount.parent),
                self._prefixes[name] + mount.name,
                mount.position,
                mount.rotation,
            )
            for topics in self._groups
            for name in topics.group.names
            for mount in topics.mounts
        ]
        bag.write("/tf_static", types.make("tf2_msgs/TFMessage", transforms=transforms), 0, latched=True)

    def step(self, after: TensorDictBase) -> None:
        """Write the actions of a step, and what is seen after it."""
        for index, topics in enumerate(self._groups):
            name = topics.group.name
            actions = after[name, "action"].numpy()
            ended = self._simulation.state.groups[name].done
            for scene, recordings in self._agents.items():
                for agent, recording in enumerate(recordings[index]):
                    if recording.begun and not ended[scene * topics.group.count + agent]:
                        recording.write_action(actions[scene, agent], self._seen_ns[scene])
        self._write_states(list(self._bags))

    def _write_states(self, scenes: list[int]) -> None:
        if not scenes:
            return
        state = self._simulation.state
        for scene in scenes:
            self._seen_ns[scene] = time_ns_of(int(self._simulation.steps[scene]), self._step_s)
            types, bag = self._bags[scene].types, self._bags[scene]
            clock = types.make("rosgraph_msgs/Clock", clock=types.time(self._seen_ns[scene]))
            bag.write("/clock", clock, self._seen_ns[scene])
        for index, topics in enumerate(self._groups):
            ended = state.groups[topics.group.name].done
            readings, scans = topics.readings(), topics.scans()
            for scene in scenes:
                for agent, recording in enumerate(self._agents[scene][index]):
                    if not ended[scene * topics.group.count + agent]:
                        recording.write_state(state, self._seen_ns[scene], readings, scans)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Put the bag of an episode that has ended in its place."""
        episode = int(next(iter(rows.values()))[0]["episode"])
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        self._close(scene).complete()

    def _close(self, scene: int) -> EpisodeBag:
        del self._agents[scene]
        return self._bags.pop(scene)

    def close(self) -> None:
        """Discard the bags of episodes that have not ended."""
        for scene in list(self._bags):
            self._close(scene).discard()
