"""Evaluation of the policies while they are trained."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from torchrl.envs import EnvBase

from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.evaluation import EpisodeObserver, evaluate
from dune_rl.learning.group_policy import Deterministic, JointPolicy
from dune_rl.learning.settings import EvaluationConf
from dune_rl.statistics.measures import MetricsRow, average_metrics, mean_of_known, selection_score


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
        self._policy = Deterministic(JointPolicy(self._policies.values()))
        self._best_score = -float("inf")
        self._evaluated_at = -1
        self._next_at = conf.every_frames
        self.rows: dict[str, list[MetricsRow]] = {}

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
            self._best_score = mean
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
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        self._best_score = state["best_score"]
        self._evaluated_at = state["evaluated_at"]
        self._next_at = state["next_evaluation"]

    def close(self) -> None:
        self._env.close()
