"""The episodes of a run: one after another, until its control steps are used up."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from dune_rl.env.simulation import VectorSimulation
from dune_rl.evaluation.blocks import FinishedEpisode
from dune_rl.evaluation.protocols.attempts import Attempt, AttemptRecorder, cut_attempts
from dune_rl.evaluation.protocols.settings import EPISODES_PER_RUN
from dune_rl.geometry.arrays import Floats
from dune_rl.learning.evaluation import EpisodeObserver
from dune_rl.statistics.measures import MetricsRow

Record = Callable[[str, MetricsRow], dict[str, Any]]


class RunObserver:
    """Observes the episodes of a run of `steps` control steps, and cuts the last one off.

    The run's episodes are those from number `first` on; scenes may run them side by side. `inner` passes each
    finished episode to `add`. `record` makes a row of the tables of a group's metrics.
    """

    inner: EpisodeObserver

    def __init__(
        self,
        simulation: VectorSimulation,
        group: str,
        run: int,
        steps: int,
        record: Record,
        attempts: AttemptRecorder | None,
    ) -> None:
        self._simulation, self._group, self._run, self._steps = simulation, group, run, steps
        self._record, self._attempts = record, attempts
        self._names = simulation.metric_names(group)
        # The metrics (M, K) after each step, and the first of each scene's present episode among them.
        self._history: list[Floats] = []
        self._began = np.zeros(simulation.num_scenes, np.int64)
        self._traces: dict[int, Floats] = {}
        self._finished: dict[int, FinishedEpisode] = {}
        self.first = self._next = run * EPISODES_PER_RUN
        self._used = 0

    def begin(self) -> None:
        self._began[self._simulation.steps == 0] = len(self._history)
        if self._attempts is not None:
            self._attempts.begin()
        self.inner.begin()

    def step(self, after: TensorDictBase) -> None:
        self._history.append(after["next", self._group, "metrics"][:, 0].numpy().copy())
        if self._attempts is not None:
            self._attempts.step()
        self.inner.step(after)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        episode = int(rows[self._group][0]["episode"])
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        self._traces[episode] = np.stack([each[scene] for each in self._history[self._began[scene] :]])
        self.inner.finish(rows)
        if self._attempts is not None:
            plain = list(map(asdict, self._attempts.finish(scene)))
            self._finished[episode] = replace(self._finished[episode], attempts=plain)
        while self._next in self._finished:
            self._used += len(self._traces[self._next])
            self._next += 1

    def add(self, episode: FinishedEpisode) -> None:
        """Take a finished episode from `inner`."""
        self._finished[episode.episode] = episode

    def is_full(self) -> bool:
        """Whether the consecutive episodes that have finished have all steps of the run."""
        return self._used >= self._steps

    def episodes(self) -> list[FinishedEpisode]:
        """The episodes of the run; the last one has the metrics that it had at the run's last step."""
        found: list[FinishedEpisode] = []
        left = self._steps
        for number in range(self.first, self._next):
            if not left:
                break
            steps = len(self._traces[number])
            episode = self._finished[number]
            found.append(self._marked(episode, True) if steps <= left else self._cut(episode, left))
            left -= min(steps, left)
        return found

    def _marked(self, episode: FinishedEpisode, finished: bool) -> FinishedEpisode:
        marks = {"run": self._run, "finished": int(finished)}
        rows = {group: [{**row, **marks} for row in agents] for group, agents in episode.rows.items()}
        steps = [{**row, "run": self._run} for row in episode.steps]
        return replace(episode, rows=rows, steps=steps)

    def _cut(self, episode: FinishedEpisode, steps: int) -> FinishedEpisode:
        values = self._traces[episode.episode][steps - 1].tolist()
        row = self._record(self._group, {"agent": 0.0, **dict(zip(self._names, values, strict=True))})
        (before,) = episode.rows[self._group]
        step_s = self._simulation.state.groups[self._group].episode.step_s
        attempts = cut_attempts([Attempt(**one) for one in episode.attempts], steps * step_s)
        kept = [one for one in episode.steps if one["step"] <= steps]
        plain = list(map(asdict, attempts))
        cut = replace(episode, rows={self._group: [before | row]}, steps=kept, attempts=plain)
        return self._marked(cut, False)
