"""How the package's episode sets are made: sampled starts and goals on sites that training never draws."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.config.schema import EnvConf
from dune_rl.episode_sets.apply import footprint_radius_m
from dune_rl.episode_sets.episode_set import SetEpisode
from dune_rl.errors import WorldError
from dune_rl.seeding import stream
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.worlds.world import World

# conf/randomisation/worlds.yaml draws seeds from 1000 on, and the default sites have seed 0.
FIRST_SITE = 500
SITES = 50
EPISODES = 200
FAMILIES = ("flat", "inspection", "construction", "rubicon", "island")
_TRIES = 2_000
_SET_SEED = 140_000


@dataclass(frozen=True)
class SetVariant:
    """A kind of sets, of which every world family has one.

    `overrides` are settings beside the defaults; goals lie `goal_distance_m` from the start [m].
    """

    suffix: str
    meaning: str
    overrides: tuple[str, ...] = ()
    goal_distance_m: tuple[float, float | None] = (2.0, None)


VARIANTS = (
    SetVariant("", "goals on the world's own square, two walkers"),
    SetVariant(
        "-site",
        "starts and goals anywhere on the site, 15 to 50 m apart, two walkers",
        (
            "task.spawn.region=anywhere",
            "task.spawn.min_goal_distance_m=15.0",
            "task.terminations.time_limit.max_steps=6000",
        ),
        (15.0, 50.0),
    ),
    SetVariant("-crowd", "goals on the world's own square, eight walkers", ("actors.walker.count=8",)),
)


@dataclass(frozen=True)
class SetRecipe:
    """The settings from which a set is made."""

    family: str
    variant: SetVariant
    robot: str = "rover_zero"
    episodes: int = EPISODES
    sites: int = SITES
    version: int = 1

    @property
    def name(self) -> str:
        """The set's name."""
        return f"{self.family}{self.variant.suffix}-v{self.version}"

    @property
    def seed(self) -> int:
        """The seed of everything that the set's episodes draw: another for each set."""
        return _SET_SEED + 10 * FAMILIES.index(self.family) + VARIANTS.index(self.variant)

    def settings(self) -> EnvConf:
        """The settings of the episodes."""
        return compose_environment(self.family, [f"robot={self.robot}", *self.variant.overrides])

    def header(self, sites: int) -> dict[str, Any]:
        """The header of the set's file; see `SetHeader`."""
        conf = self.settings()
        data = conf.model_dump(mode="json")
        determined = {key: data[key] for key in ("world", "weather", "actors", "randomisation")}
        determined["task"] = {key: data["task"][key] for key in ("spawn", "terminations")}
        places = f"{sites} sites" if sites > 1 else "one site, since the world has no seed"
        return {
            "name": self.name,
            "description": f"{self.family}: {self.variant.meaning}; {self.episodes} episodes on {places}",
            "robot": self.robot,
            "footprint_radius_m": round(footprint_radius_m(conf), 4),
            "episodes": self.episodes,
            "sites": sites,
            "goal_distance_m": list(self.variant.goal_distance_m),
            "seed": self.seed,
            "settings": determined,
            "command": f"python -m dune_rl.episode_sets make {self.name}",
        }


def all_recipes() -> dict[str, SetRecipe]:
    """The recipes of the package's sets, by name."""
    recipes = (SetRecipe(family, variant) for family in FAMILIES for variant in VARIANTS)
    return {recipe.name: recipe for recipe in recipes}


def generate_episodes(recipe: SetRecipe) -> tuple[SetEpisode, ...]:
    """All episodes of a recipe: as many on each site, site after site. Slow: it builds every site."""
    conf = recipe.settings()
    if not hasattr(conf.world, "seed"):
        return tuple(_episodes_on_site(recipe, conf, None, range(recipe.episodes)))
    each = recipe.episodes // recipe.sites
    found: list[SetEpisode] = []
    seed = FIRST_SITE
    while len(found) < recipe.episodes:
        numbers = range(len(found), len(found) + each)
        try:
            _check_paths(recipe, conf, seed)
            found += _episodes_on_site(recipe, conf, seed, numbers)
        except WorldError:
            # A site without room, such as one where no goal is far enough: the next one takes its place.
            if seed > FIRST_SITE + 2 * recipe.sites:
                raise
        seed += 1
    return tuple(found)


def _check_paths(recipe: SetRecipe, conf: EnvConf, world_seed: int) -> None:
    """Raise WorldError if the walkers have no path on a site."""
    world = conf.world.model_copy(update={"seed": world_seed})
    make_simulation(conf.model_copy(update={"world": world}), 1, recipe.seed).close()


def generate_on_site(recipe: SetRecipe, world_seed: int | None, numbers: Iterable[int]) -> list[SetEpisode]:
    """The episodes of these numbers, if they are on the site of `world_seed`."""
    return _episodes_on_site(recipe, recipe.settings(), world_seed, numbers)


def _episodes_on_site(
    recipe: SetRecipe, conf: EnvConf, world_seed: int | None, numbers: Iterable[int]
) -> list[SetEpisode]:
    world_conf = conf.world if world_seed is None else conf.world.model_copy(update={"seed": world_seed})
    world = build_world(world_conf)
    spawner = Spawner(world, conf.task.spawn, footprint_radius_m(conf))
    return [_episode(recipe, conf, world, spawner, world_seed, number) for number in numbers]


def _episode(
    recipe: SetRecipe, conf: EnvConf, world: World, spawner: Spawner, world_seed: int | None, number: int
) -> SetEpisode:
    draws = stream(recipe.seed, "episode set", number)
    room = footprint_radius_m(conf) + conf.task.spawn.margin_m
    low, high = recipe.variant.goal_distance_m
    for _ in range(_TRIES):
        placement = _rounded(spawner.sample(draws))
        ends = np.array([[placement.x, placement.y], [placement.goal_x, placement.goal_y]])
        distance = float(np.hypot(*(ends[1] - ends[0])))
        apart = low <= distance and (high is None or distance <= high)
        # Again, since rounding moves points.
        free = (world.clearance(ends) >= room).all() and not any(spawner.why_not(x, y) for x, y in ends)
        if apart and free:
            return SetEpisode(
                number,
                world_seed,
                (placement.x, placement.y, placement.yaw),
                (placement.goal_x, placement.goal_y),
            )
    raise WorldError(
        f"{recipe.name}: site {world_seed} has no start and goal {low:g} to {high:g} m apart; take another"
    )


def _rounded(placement: Placement) -> Placement:
    return replace(
        placement,
        x=round(placement.x, 3),
        y=round(placement.y, 3),
        yaw=round(placement.yaw, 4),
        goal_x=round(placement.goal_x, 3),
        goal_y=round(placement.goal_y, 3),
    )
