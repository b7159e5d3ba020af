"""Evaluation on numbered episodes, the same for every policy."""

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.process import preserve_random_state
from dune_rl.statistics.measures import MetricsRow


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
