"""Recipes for episode sets of a user's own, from words as on a command line."""

import re
from collections.abc import Sequence

from dune_rl.config.compose import compose_environment, override_value
from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.episode_sets.apply import refuse_several_robots
from dune_rl.evaluation.episode_sets.episode_set import NAME_PATTERN
from dune_rl.evaluation.episode_sets.generate import SetRecipe, all_recipes


def own_recipe(
    name: str,
    words: Sequence[str],
    episodes: int = 100,
    sites: int = 1,
    farthest: float | None = None,
    seed: int = 0,
) -> SetRecipe:
    """A recipe from settings such as +world=NAME and robot=NAME; raises ConfigError where it cannot be one.

    Goals lie at least `task.spawn.min_goal_distance_m` from the start, and at most `farthest` [m].
    """
    _check_name(name)
    world = override_value(words, "world")
    if not isinstance(world, str):
        raise ConfigError(f"the set {name} needs a world: +world=NAME")
    others = [word for word in words if not word.lstrip("+").startswith("world=")]
    conf = compose_environment(world, others)
    refuse_several_robots(name, conf)
    if episodes < 1 or sites < 1 or episodes % sites:
        raise ConfigError(f"--episodes {episodes} must be a multiple of --sites {sites}, and both at least 1")
    if sites > 1 and not hasattr(conf.world, "seed"):
        raise ConfigError(f"the world {world} has no seed, and so one site; leave --sites out")
    if conf.randomisation.distributions:
        first = next(iter(conf.randomisation.distributions))
        raise ConfigError(f"a set fixes its episodes; leave randomisation.{first} out, and take --sites N")
    if seed < 0:
        raise ConfigError(f"--seed must be at least 0 (got {seed})")
    nearest = conf.task.spawn.min_goal_distance_m
    if farthest is not None and farthest <= nearest:
        raise ConfigError(
            f"--farthest {farthest:g} must be more than task.spawn.min_goal_distance_m={nearest:g}"
        )
    distances = f"{nearest:g} m or more" if farthest is None else f"{nearest:g} to {farthest:g} m"
    options = [f"--episodes={episodes}", f"--sites={sites}", f"--seed={seed}"]
    options += [] if farthest is None else [f"--farthest={farthest:g}"]
    return SetRecipe(
        name,
        world,
        tuple(others),
        f"starts and goals {distances} apart",
        (nearest, farthest),
        seed,
        episodes,
        sites,
        (*words, *options),
    )


def _check_name(name: str) -> None:
    if name in all_recipes():
        raise ConfigError(f"{name} is a set of the package; give yours another name")
    if not re.fullmatch(NAME_PATTERN, name):
        raise ConfigError(
            f"a set's name has letters, digits, '-' and '_' alone, such as mine-v1 (got {name!r})"
        )
