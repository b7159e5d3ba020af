"""Settings, plans and checks of evaluations on an episode set, and the sites that a training has drawn."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from dune_rl.config.agents import SHARED
from dune_rl.config.build import build_robot, make_simulation
from dune_rl.config.checks import validate
from dune_rl.config.compose import compose, compose_environment, override_value
from dune_rl.config.schema import EnvConf
from dune_rl.config.shorthands import replace_actors
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.env.distributions import Choice, WholeNumbers
from dune_rl.env.requests import AgentRequest, EpisodePlan, PlannedEpisode
from dune_rl.evaluation.episode_sets.files import EpisodeSet, read_episode_set
from dune_rl.evaluation.episode_sets.world_files import world_files
from dune_rl.worlds.registry import WORLDS

Model = TypeVar("Model", bound=EnvConf)

# Headers state radii with four digits [m].
_ROUNDING_M = 1e-3
# The limits of sets count control steps of this rate.
_CONTROL_HZ = 20
# How far a robot may move while it settles on the ground [m].
_SETTLED_M = 0.2
_DETERMINED = ("world", "weather", "actors", "randomisation", "task.spawn", "task.terminations")
_ONE_ROBOT = ("agents", "robots")


def refuse_several_robots(name: str, conf: EnvConf) -> None:
    """Raise ConfigError unless `conf` has the one robot that the set `name` is for."""
    if [(group.count, group.task) for group in conf.agents.values() if group.is_robot] != [(1, SHARED)]:
        raise ConfigError(
            f"set={name} is for one robot, and these settings have agents or robots of their own; evaluate "
            "them with +world=NAME episodes=N"
        )


def check_set_overrides(name: str, overrides: Sequence[str]) -> None:
    """Raise ConfigError if `overrides` (words of a command line) set what the set `name` determines."""
    for word in overrides:
        key = word.partition("=")[0].lstrip("+~").replace("/", ".")
        for section in (*_DETERMINED, "seed"):
            if key == section or key.startswith(f"{section}."):
                raise ConfigError(f"set={name} determines {section}; leave {word} out")
        if key == "scenario":
            raise ConfigError(f"set={name} determines world and actors; leave {word} out")
        if key.partition(".")[0] in _ONE_ROBOT:
            raise ConfigError(f"set={name} is for one robot; take robot=NAME in place of {word}")


def compose_on_set(
    model: type[Model],
    overrides: Sequence[str],
    config_dirs: Sequence[str],
    saved: Mapping[str, Any] | None,
) -> tuple[Model, EpisodeSet | None]:
    """As `compose`, with what the set of an override `set=NAME` determines, and this set, if there is one.

    Raises ConfigError if there is no such set, or the settings do not fit it.
    """
    name = override_value(overrides, "set")
    if name is None:
        return compose(model, overrides, config_dirs, saved), None
    episode_set = read_episode_set(str(name))
    check_set_overrides(str(name), overrides)
    words = world_words(episode_set) if saved is None else []
    conf = compose(model, [*overrides, *words], config_dirs, saved)
    return settings_on_set(conf, episode_set), episode_set


def world_words(episode_set: EpisodeSet) -> list[str]:
    """Overrides that choose the world of a set, with the settings that have no default, such as a path."""
    world = _world_of(episode_set)
    known = WORLDS.settings_class(episode_set.world)
    needed = (
        [] if known is None else [name for name, field in known.model_fields.items() if field.is_required()]
    )
    return [
        f"+world={episode_set.world}",
        *(f"world.{name}={json.dumps(world[name])}" for name in needed if name in world and name != "name"),
    ]


def _world_of(episode_set: EpisodeSet) -> dict[str, Any]:
    """Settings of the world that is built first, which some episode uses."""
    world: dict[str, Any] = episode_set.header.settings["world"]
    files, first = world_files(episode_set), episode_set.episodes[0].world_seed
    if files:
        return {**world, "path": str(files[first or 0])}
    return world if first is None else {**world, "seed": first}


def settings_on_set(conf: Model, episode_set: EpisodeSet) -> Model:
    """`conf` with the world, actors, starts and ends of a set; raises ConfigError where they do not fit."""
    refuse_several_robots(episode_set.name, conf)
    if conf.physics.control_hz != _CONTROL_HZ:
        raise ConfigError(
            f"set={episode_set.name} ends episodes after a number of steps of 1/{_CONTROL_HZ} s; leave "
            f"physics.control_hz={conf.physics.control_hz} out"
        )
    data = conf.model_dump(mode="json")
    for section, values in episode_set.header.settings.items():
        if section == "task":
            data["task"] = {**data["task"], **values}
        elif section == "actors":
            data["agents"] = replace_actors(data["agents"], values)
        else:
            data[section] = values
    data["world"] = _world_of(episode_set)
    terms = data["metrics"]["terms"]
    added = {name: term for name, term in episode_set.header.metrics.items() if name not in terms}
    data["metrics"]["terms"] = {**terms, **added}
    if "seed" in type(conf).model_fields:
        data["seed"] = episode_set.header.seed
    changed = validate(type(conf), data)
    radius, limit = footprint_radius_m(changed), episode_set.header.footprint_radius_m
    if radius > limit + _ROUNDING_M:
        raise ConfigError(
            f"set={episode_set.name} has room for footprints of {limit:.2f} m ({episode_set.header.robot}), "
            f"and the robot needs {radius:.2f} m: make a set for it with\n"
            f"python -m dune_rl.episode_sets make NAME +world={episode_set.world} robot=..."
        )
    return changed


def plan_of_set(conf: EnvConf, episode_set: EpisodeSet) -> EpisodePlan:
    """The plan of a set's episodes for the robot of `conf`."""
    (robot,) = conf.external_groups
    (agent,) = robot.agents
    planned = (({agent: AgentRequest(one.start, one.goal)}, one.world_seed) for one in episode_set.episodes)
    files = world_files(episode_set)
    worlds = [conf.world.model_copy(update={"path": str(path)}) for path in files] if len(files) > 1 else []
    return EpisodePlan([PlannedEpisode(*each) for each in planned], worlds, episode_set.header.bounds)


def settings_of_episode(conf: Model, episode_set: EpisodeSet, number: int) -> Model:
    """`conf`, which is on a set, with the world of one of its episodes as the configured one.

    Raises ConfigError if the set has no episode of that number.
    """
    if number >= len(episode_set.episodes):
        raise ConfigError(f"set={episode_set.name} has the episodes 0 to {len(episode_set.episodes) - 1}")
    seed, files = episode_set.episodes[number].world_seed, world_files(episode_set)
    if seed is None:
        return conf
    change = {"path": str(files[seed])} if files else {"seed": seed}
    return conf.model_copy(update={"world": conf.world.model_copy(update=change)})


def footprint_radius_m(conf: EnvConf) -> float:
    """Radius of the footprint of the robot of `conf` [m]."""
    return build_robot(conf.robot, 1).description.footprint_radius_m


def sites_of_training(config: Mapping[str, Any], episode_set: EpisodeSet) -> list[int]:
    """The world seeds of `episode_set` that a run with the settings `config` has or may draw, in order.

    None of a world without seeds, which is one site for everybody.
    """
    world = config.get("world") or {}
    drawn = (config.get("randomisation") or {}).get("world_seed")
    seeds = sorted({one.world_seed for one in episode_set.episodes if one.world_seed is not None})
    seeds = [seed for seed in seeds if _family(world, seed) == episode_set.world]
    if drawn is None:
        return [seed for seed in seeds if seed == world.get("seed")]
    found = TypeAdapter[Any](WholeNumbers).validate_python(drawn)
    if isinstance(found, Choice):
        return [seed for seed in seeds if seed in found.values]
    low, high = found.limits
    return [seed for seed in seeds if low <= seed <= high]


def _family(world: Mapping[str, Any], seed: int) -> str | None:
    """The name of the world that the settings `world` have for a seed: of a mixture, one of its families."""
    try:
        return WORLDS.parse_settings({**world, "seed": seed}).drawn().name
    except (ConfigError, ValueError):
        return world.get("name")


def faulty_episodes(
    episode_set: EpisodeSet, numbers: Sequence[int] | None = None, overrides: Sequence[str] = ()
) -> list[str]:
    """Start episodes (None: all) and return a line for each that is faulty.

    It is if it does not start, if the robot touches something or settles away from its start, or if the goal
    is at another distance than the set says.

    `overrides` are settings of the robot, where its name does not tell all of it.
    """
    header = episode_set.header
    words = [f"robot={header.robot}", "sensors.enabled=[goal]", *overrides]
    conf = settings_on_set(compose_environment(header.settings["world"], words), episode_set)
    simulation = make_simulation(conf, 1, header.seed, plan=plan_of_set(conf, episode_set))
    faults = []
    try:
        for number in range(len(episode_set.episodes)) if numbers is None else numbers:
            row = episode_set.episodes[number]
            simulation.reseed(header.seed, number)
            try:
                simulation.reset()
            except (ValueError, WorldError) as error:
                faults.append(f"episode {number}: {error}")
                continue
            (group,) = simulation.external
            state = simulation.state.groups[group.name]
            moved = float(np.hypot(*(state.motion.position_w[0, :2] - row.start[:2])))
            if moved > _SETTLED_M:
                faults.append(f"episode {number}: the robot settles {moved:.2f} m from its start")
            distance = float(np.hypot(*np.subtract(row.goal, row.start[:2])))
            low, high = header.goal_distance_m
            if distance < low or (high is not None and distance > high):
                faults.append(f"episode {number}: the goal is {distance:.2f} m from the start")
    finally:
        simulation.close()
    return faults
