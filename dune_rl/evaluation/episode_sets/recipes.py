"""Recipes of episode sets, those of the package's sets, and the episodes that recipes sample."""

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.evaluation.episode_sets.apply import footprint_radius_m
from dune_rl.evaluation.episode_sets.files import SetEpisode
from dune_rl.evaluation.episode_sets.world_files import describe_files
from dune_rl.tasks.spawn import Spawner
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

_TRIES = 2_000
BARN_SCORE: dict[str, dict[str, Any]] = {"barn_score": {"reduce": "last", "initial": 0.0}}
_NO_SEED = ", since the world has no seed"


@dataclass(frozen=True)
class SetVersion:
    """What the sets of one version have in common.

    The sites of a set have world seeds from `first_site` on; those of sets with far goals from
    `first_far_site` on. `randomisation=worlds` draws seeds from 1,000 to 1,000,000, and the default sites
    have seed 0: neither is among them. `seed` is that of the first set; `robot` is the one whose footprint
    starts and goals have room for.
    """

    suffix: str
    episodes: int
    sites: int
    first_site: int
    first_far_site: int
    seed: int
    robot: str


V1 = SetVersion("-v1", 200, 50, 500, 500, 140_000, "rover_zero")
# Of the package's robots the HyperDog is the largest, so that all of them drive on these sets.
V2 = SetVersion("-v2", 1_000, 250, 5_000_000, 5_100_000, 240_000, "hyperdog")
FAMILIES = ("flat", "inspection", "construction", "rubicon", "island")

# Kinds of sets: the end of its name, its meaning, settings beside the defaults, and how far goals lie from
# the start [m].
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
# Sites without a path for some walker when these sets were made, by fewer draws than are made now.
_LEFT_OUT = {
    "construction-site-v1": (546,),
    "construction-site-v2": (5_100_059, 5_100_124, 5_100_188),
    "construction-crowd-v2": (5_000_075,),
}
# Sets that only the first version has.
_FIRST_ALONE = {("rubicon", "-crowd"), ("island", "-crowd")}


@dataclass(frozen=True)
class SetRecipe:
    """What a set is made from: a world, and `overrides` of the settings of its episodes.

    `words` are those of the command line after the name, if it is not one of the package's sets. `seed` is
    that of everything that the episodes draw. With several `sites`, these have world seeds from `first_site`
    on, but for those `left_out`; one site is the world as its settings have it. Several world `files` are
    the sites instead. `metrics` are terms that are measured beside those of an evaluation. Episodes begin at
    `start` (x, y, yaw) and end at `goal` (x, y) [m, rad] where these are given.
    """

    name: str
    world: str
    overrides: tuple[str, ...]
    meaning: str
    goal_distance_m: tuple[float, float | None]
    seed: int
    episodes: int
    sites: int
    first_site: int = V1.first_site
    left_out: tuple[int, ...] = ()
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float] | None = None

    @cached_property
    def settings(self) -> EnvConf:
        """The settings of the episodes."""
        return compose_environment(self.world, self.overrides)

    def world_of(self, site: int | None) -> WorldSettings:
        """Settings of the world of a seed, or of the file of a number; None: as the settings have it."""
        conf = self.settings.world
        if self.files:
            return conf.model_copy(update={"path": str(self.files[site or 0].absolute())})
        return conf if site is None else conf.model_copy(update={"seed": site})

    def header(self, sites: int, folder: Path = Path()) -> dict[str, Any]:
        """The header of the set's file in `folder`; see `SetHeader`."""
        data = self.settings.model_dump(mode="json")
        determined = {key: data[key] for key in ("world", "weather", "randomisation")}
        determined["actors"] = {name: data["agents"][name] for name in self.settings.actors}
        determined["task"] = {key: data["task"][key] for key in ("spawn", "terminations")}
        seeded = self.words or hasattr(self.settings.world, "seed")
        places = f"{sites} sites" if sites > 1 else "one site" + ("" if seeded else _NO_SEED)
        own: dict[str, Any] = {"metrics": self.metrics} if self.metrics else {}
        if self.files:
            own["files"] = describe_files(self.files, folder)
            determined["world"] = {**data["world"], "path": own["files"][0]["path"]}
        if len(self.files) > 1:
            extents = np.array([build_world(self.world_of(site)).extent for site in range(len(self.files))])
            own["bounds"] = [*np.where([True, False, True, False], extents.min(0), extents.max(0)).tolist()]
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
            **own,
            "command": shlex.join(["python", "-m", "dune_rl.episode_sets", "make", self.name, *self.words]),
        }


def all_recipes() -> dict[str, SetRecipe]:
    """The recipes of the package's sets, by name."""
    recipes = [
        _of_version(version, number, family, variant)
        for version in (V1, V2)
        for number, family in enumerate(FAMILIES)
        for variant, (suffix, *_) in enumerate(VARIANTS)
        if version is V1 or (family, suffix) not in _FIRST_ALONE
    ]
    return {recipe.name: recipe for recipe in [*recipes, _obstacle_courses()]}


def _of_version(version: SetVersion, number: int, family: str, variant: int) -> SetRecipe:
    suffix, meaning, words, distances_m = VARIANTS[variant]
    name = f"{family}{suffix}{version.suffix}"
    overrides = (f"robot={version.robot}", *words.split(), *_OF_FAMILY.get((family, suffix), "").split())
    return SetRecipe(
        name,
        family,
        overrides,
        meaning,
        distances_m,
        # Another seed for each set.
        version.seed + 10 * number + variant,
        version.episodes,
        version.sites,
        version.first_far_site if suffix == "-site" else version.first_site,
        _LEFT_OUT.get(name, ()),
    )


def _obstacle_courses() -> SetRecipe:
    """Narrow places of every difficulty: the density of a course follows from its seed."""
    overrides = (
        *("robot=rover_zero", "actors=none", "world.fill=[0.1,0.3]"),
        *("task.spawn.min_goal_distance_m=7", "task.spawn.passage_m=0.46"),
    )
    return SetRecipe(
        f"obstacle_course{V2.suffix}",
        "obstacle_course",
        overrides,
        "goals at the other end of the course",
        (7.0, None),
        V2.seed + 10 * len(FAMILIES),
        V2.episodes,
        V2.sites,
        V2.first_site,
        metrics=BARN_SCORE,
    )


def generate_episodes(recipe: SetRecipe) -> tuple[SetEpisode, ...]:
    """All episodes of a recipe: as many on each site, site after site. Slow: it builds every site."""
    if recipe.sites == 1 or not (recipe.files or hasattr(recipe.settings.world, "seed")):
        return tuple(_generate_on(recipe, None, range(recipe.episodes)))
    each = recipe.episodes // recipe.sites
    found: list[SetEpisode] = []
    for site in range(recipe.sites) if recipe.files else count(recipe.first_site):
        if site in recipe.left_out:
            continue
        try:
            found += _generate_on(recipe, site, range(len(found), len(found) + each))
        except WorldError:
            # A site without room, such as one where no goal is far enough: the next one takes its place.
            if recipe.files or site > recipe.first_site + 2 * recipe.sites:
                raise
        if len(found) == recipe.episodes:
            break
    return tuple(found)


def _generate_on(recipe: SetRecipe, site: int | None, numbers: Sequence[int]) -> list[SetEpisode]:
    """As `generate_on_site`; raises WorldError, with the file's name, also where the walkers have no path."""
    try:
        if site is not None:
            conf = recipe.settings.model_copy(update={"world": recipe.world_of(site)})
            make_simulation(conf, 1, recipe.seed).close()
        return generate_on_site(recipe, site, numbers)
    except WorldError as error:
        if not recipe.files:
            raise
        raise WorldError(f"{recipe.files[site or 0]}: {error}") from None


def generate_on_site(recipe: SetRecipe, site: int | None, numbers: Iterable[int]) -> list[SetEpisode]:
    """The episodes of these numbers, on the site of a world's seed or of a file's number; see `world_of`."""
    conf, world = recipe.settings, build_world(recipe.world_of(site))
    spawner = Spawner(world, conf.task.spawn, footprint_radius_m(conf))
    if recipe.start is None or recipe.goal is None:
        return [_episode(recipe, conf, world, spawner, site, number) for number in numbers]
    for what, (x, y) in (("start", recipe.start[:2]), ("goal", recipe.goal)):
        reason = spawner.why_not(x, y)
        if reason:
            raise WorldError(f"the {what} ({x:g}, {y:g}) {reason}")
    return [SetEpisode(number, site, recipe.start, recipe.goal) for number in numbers]


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
