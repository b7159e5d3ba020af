"""Starts and goals in place of sampled ones: of a user, and of episodes that are planned beforehand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dune_rl.env.arguments import check_whole
from dune_rl.tasks.spawn import Placement
from dune_rl.worlds.world import Rectangle

_KEYS = ("start", "goal", "episode")
_LAST_EPISODE = 2**40 - 1
# PettingZoo's test of parallel environments passes {"options": 1}.
_IGNORED = "options"


@dataclass(frozen=True)
class AgentRequest:
    """Where an agent starts (x, y, yaw) and where it is to go (x, y) [m, rad]; None: as sampled."""

    start: tuple[float, float, float | None] | None = None
    goal: tuple[float, float] | None = None

    def applied(self, sampled: Placement) -> Placement:
        """`sampled` with what is asked for."""
        placement = sampled
        if self.start is not None:
            x, y, yaw = self.start
            placement = replace(placement, x=x, y=y, yaw=sampled.yaw if yaw is None else yaw)
        if self.goal is not None:
            placement = replace(placement, goal_x=self.goal[0], goal_y=self.goal[1])
        return placement


EpisodeRequest = dict[str, AgentRequest]


def parse_options(
    options: Mapping[str, Any] | None, agents: Sequence[str]
) -> tuple[int | None, EpisodeRequest]:
    """The number of the episode, and starts and goals by agent, of the `options` of `reset`.

    `start` is (x, y) or (x, y, yaw) and `goal` (x, y) where there is one agent; with several they are
    mappings from agents. Raises ValueError for anything else.
    """
    options = {} if options is None else options
    if not isinstance(options, Mapping):
        raise ValueError(f"options must be a mapping with {', '.join(_KEYS)} (got {options!r})")
    unknown = [repr(key) for key in options if key not in (*_KEYS, _IGNORED)]
    if unknown:
        raise ValueError(f"reset has no options {', '.join(unknown)}; there are {', '.join(_KEYS)}")
    episode = options.get("episode")
    if episode is not None:
        check_whole("options['episode']", episode, at_least=0)
        if episode > _LAST_EPISODE:
            raise ValueError(f"options['episode'] must be at most {_LAST_EPISODE} (got {episode})")
    starts = _by_agent("start", options.get("start"), agents)
    goals = _by_agent("goal", options.get("goal"), agents)
    request: EpisodeRequest = {}
    for agent in agents:
        start, goal = _numbers("start", starts.get(agent), (2, 3)), _numbers("goal", goals.get(agent), (2,))
        if start is None and goal is None:
            continue
        request[agent] = AgentRequest(
            None if start is None else (start[0], start[1], start[2] if len(start) == 3 else None),
            None if goal is None else (goal[0], goal[1]),
        )
    return episode, request


def plain_request(request: EpisodeRequest) -> dict[str, list[Any]]:
    """Plain data of a request, for `request_from_plain`."""
    return {agent: [one.start and [*one.start], one.goal and [*one.goal]] for agent, one in request.items()}


def request_from_plain(plain: Mapping[str, Sequence[Any]]) -> EpisodeRequest:
    """The request of which `plain_request` made `plain`."""
    return {
        agent: AgentRequest(start and (start[0], start[1], start[2]), goal and (goal[0], goal[1]))
        for agent, (start, goal) in plain.items()
    }


def _by_agent(key: str, value: Any, agents: Sequence[str]) -> Mapping[str, Any]:
    if value is None:
        return {}
    if isinstance(value, Mapping):
        unknown = [str(agent) for agent in value if agent not in agents]
        if unknown:
            raise ValueError(
                f"options[{key!r}] names no agent {', '.join(unknown)}; there are {', '.join(agents)}"
            )
        return value
    if len(agents) > 1:
        raise ValueError(f"options[{key!r}] must be a mapping from agents: {', '.join(agents)}")
    return {agents[0]: value}


def _numbers(key: str, value: Any, sizes: tuple[int, ...]) -> list[float] | None:
    if value is None:
        return None
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.ndim != 1 or len(numbers) not in sizes or not np.isfinite(numbers).all():
        count = " or ".join(map(str, sizes))
        raise ValueError(f"options[{key!r}] must be {count} finite numbers (got {value!r})")
    found: list[float] = numbers.tolist()
    return found


@dataclass(frozen=True)
class PlannedEpisode:
    """Starts and goals by agent, and the seed of the world; None: the configured world.

    Where a plan has `worlds`, the seed is the number of one of them.
    """

    request: EpisodeRequest = field(default_factory=dict)
    world_seed: int | None = None


class EpisodePlan:
    """Planned episodes by number; numbers beyond the last one begin again at the first.

    What a plan does not set, such as the actors' paths, depends on (seed, episode id) as without a plan.
    `worlds` are settings of worlds that episodes choose by number; they may differ in extent within `bounds`
    (xmin, xmax, ymin, ymax) [m], by which readings are bounded. Raises ValueError if there is no
    episode, or if only some have a world of their own.
    """

    def __init__(
        self, episodes: Sequence[PlannedEpisode], worlds: Sequence[Any] = (), bounds: Rectangle | None = None
    ) -> None:
        with_world = sum(one.world_seed is not None for one in episodes)
        if not episodes or with_world not in (0, len(episodes)):
            raise ValueError("a plan needs episodes, and a world seed in all of them or in none")
        self._episodes = tuple(episodes)
        self.worlds, self.bounds = tuple(worlds), bounds
        self.sets_worlds = with_world > 0

    def of(self, episode: int) -> PlannedEpisode:
        """The planned episode of this number."""
        return self._episodes[episode % len(self._episodes)]
