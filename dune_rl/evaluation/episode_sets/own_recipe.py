"""Recipes of users' own episode sets, from the words of a command line."""

import math
import re
from collections.abc import Sequence

import numpy as np

from dune_rl.config.compose import compose_environment, override_value
from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.episode_sets.apply import refuse_several_robots
from dune_rl.evaluation.episode_sets.files import NAME_PATTERN
from dune_rl.evaluation.episode_sets.recipes import BARN_SCORE, SetRecipe, all_recipes
from dune_rl.evaluation.episode_sets.world_files import find_world_files
from dune_rl.geometry.frames import wrap_angle

_EPISODES = 100


def own_recipe(
    name: str, words: Sequence[str], episodes: int | None = None, sites: int = 1,
    farthest: float | None = None, seed: int = 0,
) -> SetRecipe:  # fmt: skip
    """A recipe from settings such as +world=NAME and robot=NAME; raises ConfigError where it cannot be one.

    Goals lie at least `task.spawn.min_goal_distance_m` from the start, and at most `farthest` [m], unless the
    words `start=[x,y,degrees] goal=[x,y]` give both. `world.path` may be a pattern of several files.
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
    others = [word for word in words if word.lstrip("+").partition("=")[0] not in ("world", "start", "goal")]
    start, goal = _ends(words)
    conf = compose_environment(world, others)
    refuse_several_robots(name, conf)
    path = getattr(conf.world, "path", None)
    files = find_world_files(path) if isinstance(path, str) else []
    several = len(files) > 1
    if several and sites > 1:
        raise ConfigError(
            f"world.path={path} names {len(files)} files, which are the sites; leave --sites out"
        )
    sites = len(files) if several else sites
    episodes = episodes if episodes is not None else sites if several else _EPISODES
    if episodes < 1 or sites < 1 or episodes % sites:
        what = f"the number of files, {sites}," if several else f"--sites {sites},"
        raise ConfigError(f"--episodes {episodes} must be a multiple of {what} and both at least 1")
    if sites > 1 and not (several or hasattr(conf.world, "seed")):
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
    options = [f"--episodes={episodes}", *([] if several else [f"--sites={sites}"]), f"--seed={seed}"]
    options += [] if farthest is None else [f"--farthest={farthest:g}"]
    meaning, limits_m = f"starts and goals {distances} apart", (nearest, farthest)
    if start is not None and goal is not None:
        meaning = f"from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g})"
        limits_m = (min(nearest, math.dist(start[:2], goal)), None)
    return SetRecipe(
        name,
        world,
        tuple(others),
        meaning,
        limits_m,
        seed,
        episodes,
        sites,
        metrics={} if start is None else BARN_SCORE,
        words=(*words, *options),
        files=tuple(files),
        start=start,
        goal=goal,
    )


def _ends(words: Sequence[str]) -> tuple[tuple[float, float, float] | None, tuple[float, float] | None]:
    """The start (x, y, yaw) [m, rad] and the goal (x, y) [m] that `words` give; None where they give none."""
    start, goal = _numbers(words, "start", 3), _numbers(words, "goal", 2)
    if start is None and goal is None:
        return None, None
    if start is None or goal is None:
        raise ConfigError("start and goal go together: 'start=[x,y,heading in degrees]' 'goal=[x,y]'")
    yaw = float(wrap_angle(np.deg2rad(start[2])))
    return (round(start[0], 3), round(start[1], 3), round(yaw, 4)), (round(goal[0], 3), round(goal[1], 3))


def _numbers(words: Sequence[str], key: str, size: int) -> list[float] | None:
    value = override_value(words, key)
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != size or not all(map(_is_finite, value)):
        form = "[x,y,heading in degrees]" if size > 2 else "[x,y]"
        raise ConfigError(f"{key} must be {size} numbers, '{key}={form}' (got {value})")
    return [float(each) for each in value]


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
