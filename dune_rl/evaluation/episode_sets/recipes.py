"""Recipes of episode sets, the package's and a user's own, and the episodes that they sample."""

import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.compose import compose_environment, override_value
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.core.seeding import stream
from dune_rl.evaluation.episode_sets.apply import footprint_radius_m, refuse_several_robots
from dune_rl.evaluation.episode_sets.files import NAME_PATTERN, SetEpisode
from dune_rl.tasks.spawn import Spawner
from dune_rl.worlds.world import World

# conf/randomisation/worlds.yaml draws seeds from 1000 on, and the default sites have seed 0.
FIRST_SITE = 500
SITES = 50
EPISODES = 200
FAMILIES = ("flat", "inspection", "construction", "rubicon", "island")
_TRIES = 2_000
_SET_SEED = 140_000
_NO_SEED = ", since the world has no seed"


# Kinds of sets, of which every world family has one: the end of its name, its meaning, settings beside the
# defaults, and how far goals lie from the start [m].
VARIANTS: tuple[tuple[str, str, str, tuple[float, float | None]], ...] = (
    ("", "goals on the world's own square, two walkers", "", (2.0, None)),
    (
        "-site",
        "starts and goals anywhere on the site, 15 to 50 m apart, two walkers",
        "task.spawn.region=anywhere task.spawn.min_goal_distance_m=15.0 "
        "task.terminations.time_limit.max_steps=6000",
        (15.0, 50.0),
    ),
    ("-crowd", "goals on the world's own square, eight walkers", "actors.walker.count=8", (2.0, None)),
)
# What the sets of a variant need of one family: on the land of a smaller island no two places are 15 m apart.
_OF_FAMILY = {("island", "-site"): "world.radius_m=20"}


@dataclass(frozen=True)
class SetRecipe:
    """What a set is made from: a world, and `overrides` of the settings of its episodes.

    `words` are those of the command line after the name, if it is not one of the package's sets. `seed` is
    that of everything that the episodes draw. With several `sites`, these have world seeds from `FIRST_SITE`
    on; one site is the world as its settings have it.
    """

    name: str
    world: str
    overrides: tuple[str, ...]
    meaning: str
    goal_distance_m: tuple[float, float | None]
    seed: int
    episodes: int = EPISODES
    sites: int = SITES
    words: tuple[str, ...] = ()

    @cached_property
    def settings(self) -> EnvConf:
        """The settings of the episodes."""
        return compose_environment(self.world, self.overrides)

    def header(self, sites: int) -> dict[str, Any]:
        """The header of the set's file; see `SetHeader`."""
        data = self.settings.model_dump(mode="json")
        determined = {key: data[key] for key in ("world", "weather", "randomisation")}
        determined["actors"] = {name: data["agents"][name] for name in self.settings.actors}
        determined["task"] = {key: data["task"][key] for key in ("spawn", "terminations")}
        seeded = self.words or hasattr(self.settings.world, "seed")
        places = f"{sites} sites" if sites > 1 else "one site" + ("" if seeded else _NO_SEED)
        return {
            "name": self.name,
            "description": f"{self.world}: {self.meaning}; {self.episodes} episodes on {places}",
            "robot": self.settings.robot.name,
            "footprint_radius_m": round(footprint_radius_m(self.settings), 4),
            "episodes": self.episodes,
            "sites": sites,
            "goal_distance_m": list(self.goal_distance_m),
            "seed": self.seed,
            "settings": determined,
            "command": shlex.join(["python", "-m", "dune_rl.episode_sets", "make", self.name, *self.words]),
        }


def all_recipes() -> dict[str, SetRecipe]:
    """The recipes of the package's sets, by name."""
    recipes = {}
    for number, family in enumerate(FAMILIES):
        for variant, (suffix, meaning, words, distances_m) in enumerate(VARIANTS):
            name = f"{family}{suffix}-v1"
            overrides = ("robot=rover_zero", *words.split(), *_OF_FAMILY.get((family, suffix), "").split())
            # Another seed for each set.
            seed = _SET_SEED + 10 * number + variant
            recipes[name] = SetRecipe(name, family, overrides, meaning, distances_m, seed)
    return recipes


def generate_episodes(recipe: SetRecipe) -> tuple[SetEpisode, ...]:
    """All episodes of a recipe: as many on each site, site after site. Slow: it builds every site."""
    conf = recipe.settings
    if recipe.sites == 1 or not hasattr(conf.world, "seed"):
        return tuple(generate_on_site(recipe, None, range(recipe.episodes)))
    each = recipe.episodes // recipe.sites
    found: list[SetEpisode] = []
    seed = FIRST_SITE
    while len(found) < recipe.episodes:
        numbers = range(len(found), len(found) + each)
        try:
            # Raises WorldError as well where the walkers have no path.
            world = conf.world.model_copy(update={"seed": seed})
            make_simulation(conf.model_copy(update={"world": world}), 1, recipe.seed).close()
            found += generate_on_site(recipe, seed, numbers)
        except WorldError:
            # A site without room, such as one where no goal is far enough: the next one takes its place.
            if seed > FIRST_SITE + 2 * recipe.sites:
                raise
        seed += 1
    return tuple(found)


def generate_on_site(recipe: SetRecipe, world_seed: int | None, numbers: Iterable[int]) -> list[SetEpisode]:
    """The episodes of these numbers, on the site of `world_seed` (None: the world has no seed)."""
    conf = recipe.settings
    world_conf = conf.world if world_seed is None else conf.world.model_copy(update={"seed": world_seed})
    world = build_world(world_conf)
    spawner = Spawner(world, conf.task.spawn, footprint_radius_m(conf))
    return [_episode(recipe, conf, world, spawner, world_seed, number) for number in numbers]


def _episode(
    recipe: SetRecipe, conf: EnvConf, world: World, spawner: Spawner, world_seed: int | None, number: int
) -> SetEpisode:
    draws = stream(recipe.seed, "episode set", number)
    room = footprint_radius_m(conf) + conf.task.spawn.margin_m
    low, high = recipe.goal_distance_m
    for _ in range(_TRIES):
        drawn = spawner.sample(draws)
        start = round(drawn.x, 3), round(drawn.y, 3), round(drawn.yaw, 4)
        goal = round(drawn.goal_x, 3), round(drawn.goal_y, 3)
        ends = np.array([start[:2], goal])
        distance = float(np.hypot(*(ends[1] - ends[0])))
        apart = low <= distance and (high is None or distance <= high)
        # Again, since rounding moves points.
        free = (world.clearance(ends) >= room).all() and not any(spawner.why_not(x, y) for x, y in ends)
        if apart and free:
            return SetEpisode(number, world_seed, start, goal)
    site = "the world" if world_seed is None else f"site {world_seed}"
    apart_m = f"at least {low:g} m" if high is None else f"{low:g} to {high:g} m"
    raise WorldError(f"{recipe.name}: {site} has no start and goal {apart_m} apart; take other distances")


def own_recipe(
    name: str, words: Sequence[str], episodes: int = 100, sites: int = 1, farthest: float | None = None,
    seed: int = 0,
) -> SetRecipe:  # fmt: skip
    """A recipe from settings such as +world=NAME and robot=NAME; raises ConfigError where it cannot be one.

    Goals lie at least `task.spawn.min_goal_distance_m` from the start, and at most `farthest` [m].
    """
    if name in all_recipes():
        raise ConfigError(f"{name} is a set of the package; give yours another name")
    if not re.fullmatch(NAME_PATTERN, name):
        raise ConfigError(
            f"a set's name has letters, digits, '-' and '_' alone, such as mine-v1 (got {name!r})"
        )
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
    meaning, limits_m = f"starts and goals {distances} apart", (nearest, farthest)
    all_words = (*words, *options)
    return SetRecipe(name, world, tuple(others), meaning, limits_m, seed, episodes, sites, all_words)
