"""Episode sets: numbered episodes with fixed worlds, starts and goals, the same for every policy."""

from dune_rl.evaluation.episode_sets.apply import (
    check_set_overrides,
    plan_of_set,
    settings_on_set,
    sites_of_training,
)
from dune_rl.evaluation.episode_sets.episode_set import EpisodeSet, SetEpisode
from dune_rl.evaluation.episode_sets.files import read_episode_set, set_names, write_episode_set

__all__ = [
    "EpisodeSet",
    "SetEpisode",
    "check_set_overrides",
    "plan_of_set",
    "read_episode_set",
    "set_names",
    "settings_on_set",
    "sites_of_training",
    "write_episode_set",
]
