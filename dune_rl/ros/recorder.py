"""Records episodes as bags: an observer of evaluations."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from dune_rl.env.simulation import VectorSimulation
from dune_rl.ros.bag import EpisodeBag, episode_path
from dune_rl.ros.library import require_rosbags
from dune_rl.ros.scene_recording import SceneRecording, SimulationTopics
from dune_rl.ros.times import time_ns_of
from dune_rl.statistics.measures import MetricsRow


class BagRecorder:
    """Writes a bag of each episode of external agents that ends, into `folder`.

    `episodes` are the numbers of those that are run; other scenes rest. With several agents their topics and
    frames have namespaces, their names. Each bag has the `metadata`, beside its number.
    Times are those of the simulation, from 0 at an episode's start.
    """

    def __init__(
        self, simulation: VectorSimulation, folder: Path, episodes: range, metadata: Mapping[str, Any]
    ) -> None:
        require_rosbags()
        self._simulation, self._folder = simulation, folder
        self._episodes, self._metadata = episodes, metadata
        self._step_s = simulation.physics.control_step_s
        self._topics = SimulationTopics.of(simulation, simulation.physics.action_repeat)
        self._bags: dict[int, EpisodeBag] = {}
        self._recordings: dict[int, SceneRecording] = {}
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
                bag = EpisodeBag(episode_path(self._folder, episode), {**self._metadata, "episode": episode})
                self._bags[scene] = bag
                self._recordings[scene] = SceneRecording(bag, self._topics, scene)
        self._write_states([scene for scene in self._bags if self._simulation.steps[scene] == 0])

    def step(self, after: TensorDictBase) -> None:
        """Write the actions of a step, and what is seen after it."""
        actions = {group.name: after[group.name, "action"].numpy() for group in self._simulation.external}
        for scene, recording in self._recordings.items():
            recording.write_actions(actions, self._simulation.state, self._seen_ns[scene])
        self._write_states(list(self._bags))

    def _write_states(self, scenes: list[int]) -> None:
        if not scenes:
            return
        sensed = self._topics.sense()
        for scene in scenes:
            self._seen_ns[scene] = time_ns_of(int(self._simulation.steps[scene]), self._step_s)
            self._recordings[scene].write_clock(self._seen_ns[scene])
            self._recordings[scene].write_state(self._simulation.state, self._seen_ns[scene], sensed)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Put the bag of an episode that has ended in its place."""
        episode = int(next(iter(rows.values()))[0]["episode"])
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        self._close(scene).complete()

    def _close(self, scene: int) -> EpisodeBag:
        del self._recordings[scene]
        return self._bags.pop(scene)

    def close(self) -> None:
        """Discard the bags of episodes that have not ended."""
        for scene in list(self._bags):
            self._close(scene).discard()
