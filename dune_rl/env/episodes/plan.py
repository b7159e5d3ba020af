"""Episodes that are laid down beforehand: the world's seed, starts and goals of each, by episode number."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from dune_rl.env.episodes.request import EpisodeRequest


@dataclass(frozen=True)
class PlannedEpisode:
    """Starts and goals by agent, and the seed of the world; None: the configured world."""

    request: EpisodeRequest = field(default_factory=dict)
    world_seed: int | None = None


class EpisodePlan:
    """Planned episodes by number; numbers beyond the last one begin again at the first.

    What a plan does not set, such as the actors' paths, depends on (seed, episode id) as without a plan.
    Raises ValueError if there is no episode, or if only some have a world of their own.
    """

    def __init__(self, episodes: Sequence[PlannedEpisode]) -> None:
        with_world = sum(one.world_seed is not None for one in episodes)
        if not episodes or with_world not in (0, len(episodes)):
            raise ValueError("a plan needs episodes, and a world seed in all of them or in none")
        self._episodes = tuple(episodes)
        self.sets_worlds = with_world > 0

    def of(self, episode: int) -> PlannedEpisode:
        """The planned episode of this number."""
        return self._episodes[episode % len(self._episodes)]
