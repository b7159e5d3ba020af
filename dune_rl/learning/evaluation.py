"""Evaluation on numbered episodes, the same for every policy."""

from collections.abc import Callable

import torch
from torchrl.envs import EnvBase

from dune_rl.errors import ConfigError
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.measures import MetricsRow
from dune_rl.learning.random_state import preserve_random_state


@torch.no_grad()
def evaluate(
    policy: Policy,
    env: EnvBase,
    episodes: int,
    seed: int,
    *,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, list[MetricsRow]]:
    """By group, the metrics of each agent in episodes 0 to `episodes` - 1 of `seed`, in that order.

    A row has the metrics by name and "agent", the agent's number in its group.
    `env` is a batch of scenes with metrics (`EpisodeMetrics`), seeded anew here;
    how many there are changes no row. The process's random states are left as they were. When `stop`
    returns true, the rows finished by then are returned. `progress` is called
    with the number of finished episodes. Groups without metrics are left out;
    raises ConfigError if none has any.
    """
    finished: dict[str, dict[int, list[MetricsRow]]] = {group: {} for group in env.metric_names}
    if not finished:
        raise ConfigError("no group of agents has metrics, so there is nothing to evaluate: give one a task")
    count = 0
    with preserve_random_state():
        env.set_seed(seed)
        observation = env.reset()
        while count < episodes and not stop():
            after, observation = env.step_and_maybe_reset(policy(observation))
            done = after["next", "done"].squeeze(-1)
            if not done.any():
                continue
            for group, found in finished.items():
                names = env.metric_names[group]
                for agents in after["next", group, "metrics"][done].tolist():
                    rows = [
                        {"agent": float(number), **dict(zip(names, values, strict=True))}
                        for number, values in enumerate(agents)
                    ]
                    # A scene goes on with later ids while others are still at theirs.
                    if rows[0]["episode"] < episodes:
                        found[int(rows[0]["episode"])] = rows
                count = len(found)
            progress(count)
    return {
        group: [row for episode in sorted(found) for row in found[episode]]
        for group, found in finished.items()
    }
