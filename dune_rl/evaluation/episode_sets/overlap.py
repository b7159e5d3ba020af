"""Which sites of a set a training run draws: results on these are not on unseen ones."""

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter

from dune_rl.env.distributions import Choice, WholeNumbers
from dune_rl.evaluation.episode_sets.episode_set import EpisodeSet


def sites_of_training(config: Mapping[str, Any], episode_set: EpisodeSet) -> list[int]:
    """The world seeds of `episode_set` that a run with the settings `config` has or may draw, in order.

    None of a world without seeds, which is one site for everybody.
    """
    world = config.get("world") or {}
    if world.get("name") != episode_set.world:
        return []
    drawn = (config.get("randomisation") or {}).get("world_seed")
    seeds = sorted({one.world_seed for one in episode_set.episodes if one.world_seed is not None})
    if drawn is None:
        return [seed for seed in seeds if seed == world.get("seed")]
    found = TypeAdapter[Any](WholeNumbers).validate_python(drawn)
    if isinstance(found, Choice):
        return [seed for seed in seeds if seed in found.values]
    low, high = found.limits
    return [seed for seed in seeds if low <= seed <= high]
