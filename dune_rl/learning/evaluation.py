"""Evaluation on numbered episodes, the same for every policy, also while the policies are trained."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.group_policy import Deterministic, JointPolicy, Policy
from dune_rl.learning.process import preserve_random_state
from dune_rl.learning.settings import EvaluationConf
from dune_rl.statistics.measures import MetricsRow, average_metrics, mean_of_known, selection_score


class EpisodeObserver(Protocol):
    """What is called back by `evaluate`, to record more than metrics."""

    def begin(self) -> None:
        """Scenes have been reset: all, or those that have made no step."""

    def step(self, after: TensorDictBase) -> None:
        """All scenes have made a step, and none of them has been reset since."""

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """An episode has ended: its rows by group, one for each agent, which may be added to."""


class EvaluationPictures(EpisodeObserver, Protocol):
    """An observer that can draw what it saw of the last evaluation."""

    def draw(self) -> NDArray[np.uint8]:
        """RGB (height, width, 3)."""


@torch.no_grad()
def evaluate(
    policy: Policy,
    env: EnvBase,
    episodes: int,
    seed: int,
    *,
    first: int = 0,
    observer: EpisodeObserver | None = None,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, list[MetricsRow]]:
    """By group, the metrics of each agent in `episodes` episodes of `seed`, from number `first` on, in order.

    A row has the metrics by name and "agent", the agent's number in its group. `env` is a batch of scenes
    with metrics (`EpisodeMetrics`), seeded anew here; how many there are changes no row by more than its last
    digits. The process's random states are left as they were. When `stop` returns true, the rows finished by
    then are returned. `progress` is called with the number of finished episodes. Groups without metrics are
    left out; raises ConfigError if none has any.
    """
    finished: dict[str, dict[int, list[MetricsRow]]] = {group: {} for group in env.metric_names}
    if not finished:
        raise ConfigError("no group of agents has metrics, so there is nothing to evaluate: give one a task")
    ended: set[int] = set()
    with preserve_random_state():
        env.set_seed(seed)
        if first:
            env.start_at(seed, first)
        observation = env.reset()
        if observer is not None:
            observer.begin()
        # More scenes than episodes.
        resting = _episode_ids(env) >= first + episodes
        env.rest_scenes(resting)
        while len(ended) < episodes and not stop():
            after = env.step(policy(observation))
            if observer is not None:
                observer.step(after)
            observation = env.step_mdp(after)
            done = after["next", "done"].squeeze(-1) & ~resting
            if not done.any():
                continue
            for episode, rows in _finished_rows(env, after, done).items():
                ended.add(episode)
                if observer is not None and rows:
                    observer.finish(rows)
                for group, agents in rows.items():
                    finished[group][episode] = agents
            # Nobody asks for the episodes that these scenes would go on with.
            resting |= done & (_episode_ids(env) + len(done) >= first + episodes)
            env.rest_scenes(resting)
            for key in env.done_keys:
                observation[key][resting] = False
            observation = env.maybe_reset(observation)
            if observer is not None:
                observer.begin()
            progress(len(ended))
    return {
        group: [row for episode in sorted(found) for row in found[episode]]
        for group, found in finished.items()
    }


def _episode_ids(env: EnvBase) -> torch.Tensor:
    return torch.from_numpy(env.episode_keys()[1])


def _finished_rows(
    env: EnvBase, after: TensorDictBase, done: torch.Tensor
) -> dict[int, dict[str, list[MetricsRow]]]:
    """The rows by episode and group of the scenes that are `done` (M,)."""
    ids = _episode_ids(env)[done].tolist()
    # Nobody may have come of the groups that are measured.
    found: dict[int, dict[str, list[MetricsRow]]] = {episode: {} for episode in ids}
    for group, names in env.metric_names.items():
        for agents in after["next", group, "metrics"][done].tolist():
            rows = [
                {"agent": float(number), **dict(zip(names, values, strict=True))}
                for number, values in enumerate(agents)
                # Agents that never came have no values at all.
                if not math.isnan(values[0])
            ]
            if rows:
                found[int(rows[0]["episode"])][group] = rows
    return found


class PeriodicEvaluation:
    """Evaluates the learners' policies on the same episodes every so many frames, and knows the best result.

    `env` has the scenes of the evaluation. `seed` is its episodes'. The best policies are chosen by the
    group `judged`; None: by all groups in the mean.
    """

    def __init__(
        self,
        conf: EvaluationConf,
        env: EnvBase,
        learners: Mapping[str, Algorithm],
        seed: int,
        judged: str | None = None,
    ) -> None:
        self._judged = judged
        self._conf, self._env, self._seed = conf, env, seed
        self._learners = learners
        # Evaluations act on the CPU, whatever device learns.
        self._policies = {group: learner.make_policy() for group, learner in learners.items()}
        for policy in self._policies.values():
            policy.watch(env)
        self._policy = Deterministic(JointPolicy(self._policies.values()))
        self._best_score = -float("inf")
        self._evaluated_at = -1
        self._next_at = conf.every_frames
        self.rows: dict[str, list[MetricsRow]] = {}
        self.best_rows: dict[str, list[MetricsRow]] = {}

    def is_due(self, frames: int) -> bool:
        return frames >= self._next_at

    def count_left(self, frames: int, total_frames: int) -> int:
        """How many evaluations a run of `total_frames` still makes after `frames`, the last at its end."""
        if self.is_done(total_frames):
            return 0
        every = self._conf.every_frames
        return 1 + max(0, -(-(total_frames - max(frames, self._next_at)) // every))

    @property
    def episodes(self) -> int:
        return self._conf.episodes

    @property
    def success_rate(self) -> float:
        """Of the last evaluation, the mean of the groups that have one; NaN before the first."""
        rates = (average_metrics(rows).get("SR", math.nan) for rows in self.rows.values() if rows)
        return mean_of_known(rates)

    def is_done(self, frames: int) -> bool:
        return self._evaluated_at == frames

    def run(
        self,
        frames: int,
        stop: Callable[[], bool],
        progress: Callable[[int], None] = lambda done: None,
        observer: EpisodeObserver | None = None,
    ) -> bool:
        """Evaluate the policies after `frames` into `rows`; returns whether they are the best so far.

        `progress` is called with the number of finished episodes. When `stop` returns true meanwhile, nothing
        is kept: short episodes would be over-represented, and a resumed run will evaluate again.
        """
        for group, learner in self._learners.items():
            self._policies[group].load_state_dict(learner.policy.state_dict())
        rows = evaluate(
            self._policy,
            self._env,
            self._conf.episodes,
            self._seed,
            observer=observer,
            stop=stop,
            progress=progress,
        )
        if stop():
            return False
        while self._next_at <= frames:
            self._next_at += self._conf.every_frames
        self._evaluated_at = frames
        self.rows = rows
        scores = [selection_score(each) for each in self._judged_statistics()]
        mean = sum(scores) / len(scores)
        is_best = mean >= self._best_score
        if is_best:
            self._best_score, self.best_rows = mean, rows
        return is_best

    def _judged_statistics(self) -> list[MetricsRow]:
        """The last evaluation's statistics of the groups that decide what is best."""
        chosen = {group: rows for group, rows in self.rows.items() if self._judged in (None, group)}
        return [average_metrics(episodes) for episodes in (chosen or self.rows).values()]

    def score(self) -> dict[str, Any]:
        """How the last evaluation went, for the file of a policy that was chosen by it."""
        statistics = self._judged_statistics()
        measures = ["SR" if "SR" in each else "return" for each in statistics]
        return {
            "measure": ", ".join(dict.fromkeys(measures)),
            "score": sum(selection_score(each) for each in statistics) / len(statistics),
            "episodes": self._conf.episodes,
            "seed": self._seed,
        }

    def state(self) -> dict[str, Any]:
        return {
            "best_score": self._best_score,
            "evaluated_at": self._evaluated_at,
            "next_evaluation": self._next_at,
            "rows": self.rows,
            "best_rows": self.best_rows,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        self._best_score = state["best_score"]
        self._evaluated_at = state["evaluated_at"]
        self._next_at = state["next_evaluation"]
        # Earlier versions did not save them.
        self.rows = dict(state.get("rows", {}))
        self.best_rows = dict(state.get("best_rows", self.rows))

    def close(self) -> None:
        self._env.close()
