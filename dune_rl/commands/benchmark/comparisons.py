"""Cost of four robots, of twenty actors, of each physics engine, and of queries about the ground."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch

from dune_rl.commands.benchmark.measuring import core_stepper, median_ratio, time_calls, time_in_turns
from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.schema import EnvConf
from dune_rl.config.shorthands import replace_actors
from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.interface import OWN_ENGINES

_WARM_UP = 50
_ROBOTS, _ACTORS, _POINTS = 4, 20, 100_000
# The field of the result, and the controller of the actors.
_CONTROLLERS = {"actors_cost": "path", "actors_cost_social_force": "social_force", "actors_cost_orca": "orca"}


def _time_and_close(
    simulations: Mapping[Any, VectorSimulation],
    steps: Mapping[str, tuple[Callable[[], None], int]],
    rounds: int,
) -> dict[str, list[float]]:
    """Times [s] of warm `steps` in turns, after which the simulations are closed."""
    for step, _ in steps.values():
        time_calls(step, _WARM_UP)
    times = time_in_turns(steps, rounds)
    for simulation in simulations.values():
        simulation.close()
    return times


def measure_groups(conf: BenchmarkConf) -> dict[str, Any]:
    """Overhead of four equal robots per scene, as a ratio to that of one robot in the same world.

    Overhead is the time of a control step beyond that of its bare physics:
    sensors, control, rewards, resets and bookkeeping. The robot is the one of
    the first external group; the scenes have no other agents.
    """
    torch.set_num_threads(1)
    simulations = {
        count: make_simulation(_with_robots(conf, count), conf.scenes, conf.seed) for count in (1, _ROBOTS)
    }
    steps = {}
    for count, simulation in simulations.items():
        simulation.reset()
        steps[f"core {count}"] = core_stepper(simulation), conf.steps
        steps[f"raw {count}"] = simulation.step_passive, conf.steps
    times = {
        name: np.array(values) for name, values in _time_and_close(simulations, steps, conf.rounds).items()
    }
    overhead = {count: times[f"core {count}"] - times[f"raw {count}"] for count in simulations}
    per_agent = {count: np.median(times[f"core {count}"]) / (conf.scenes * count) for count in simulations}
    return {
        "scenes": conf.scenes,
        "four_robots_overhead_ratio": float(np.median(overhead[_ROBOTS]) / np.median(overhead[1])),
        "one_robot_overhead_us": float(np.median(overhead[1])) / conf.scenes * 1e6,
        "four_robots_overhead_us": float(np.median(overhead[_ROBOTS])) / conf.scenes * 1e6,
        "one_robot_core_ratio": median_ratio(times["core 1"].tolist(), times["raw 1"].tolist()),
        "four_robots_core_ratio": median_ratio(
            times[f"core {_ROBOTS}"].tolist(), times[f"raw {_ROBOTS}"].tolist()
        ),
        "one_robot_agent_steps_per_s": float(1.0 / per_agent[1]),
        "four_robots_agent_steps_per_s": float(1.0 / per_agent[_ROBOTS]),
    }


def _with_robots(conf: BenchmarkConf, count: int) -> EnvConf:
    """The environment of `conf` with `count` of its robot and no other agents."""
    values = conf.model_dump(include=set(EnvConf.model_fields))
    body = next(group.body for group in conf.external_groups)
    values["agents"] = {"rover": {"body": body, "count": count}}
    return EnvConf.model_validate(values)


def measure_actors(conf: BenchmarkConf) -> dict[str, Any]:
    """What twenty persons beside the agents of `conf` add to a control step, as a share of it.

    Scripted ones walk on paths. They stand in the way of robots, so that physics has more contacts, and
    sensors see them: that is part of the cost.
    """
    torch.set_num_threads(1)
    controllers = {"none": None, **_CONTROLLERS}
    simulations = {
        name: make_simulation(_with_actors(conf, controller), conf.scenes, conf.seed)
        for name, controller in controllers.items()
    }
    steps = {}
    for name, simulation in simulations.items():
        simulation.reset()
        steps[name] = core_stepper(simulation), conf.steps
    times = _time_and_close(simulations, steps, conf.rounds)
    costs = {name: median_ratio(times[name], times["none"]) - 1.0 for name in _CONTROLLERS}
    return {
        "scenes": conf.scenes,
        "actors": _ACTORS,
        **costs,
        "step_without_actors_us": float(np.median(times["none"])) / conf.scenes * 1e6,
    }


def _with_actors(conf: BenchmarkConf, controller: str | None) -> EnvConf:
    """The environment of `conf` with its robots, and twenty persons of this controller, or nobody."""
    values = conf.model_dump(include=set(EnvConf.model_fields))
    crowd = {"body": {"name": "person"}, "count": _ACTORS, "controller": controller}
    values["agents"] = replace_actors(values["agents"], {} if controller is None else {"crowd": crowd})
    return EnvConf.model_validate(values)


def measure_engines(conf: BenchmarkConf) -> dict[str, Any]:
    """Physics and control steps per second of each engine and its overhead, in alternating rounds."""
    torch.set_num_threads(1)
    simulations, cores = {}, {}
    for engine in OWN_ENGINES:
        data = conf.model_dump()
        data["physics"] |= {"backend": engine}
        simulations[engine] = make_simulation(BenchmarkConf.model_validate(data), conf.scenes, conf.seed)
        simulations[engine].reset()
        cores[engine] = core_stepper(simulations[engine])
        time_calls(cores[engine], _WARM_UP)
        time_calls(simulations[engine].step_passive, _WARM_UP)
    core: dict[str, list[float]] = {engine: [] for engine in OWN_ENGINES}
    raw: dict[str, list[float]] = {engine: [] for engine in OWN_ENGINES}
    resets: dict[str, list[float]] = {engine: [] for engine in OWN_ENGINES}
    mask = np.ones(conf.scenes, bool)
    for _ in range(conf.rounds):
        for engine, simulation in simulations.items():
            core[engine].append(time_calls(cores[engine], conf.steps))
            raw[engine].append(time_calls(simulation.step_passive, conf.steps))
            resets[engine].append(time_calls(partial(simulation.reset, mask), 1))
    steps = conf.steps * conf.scenes
    figures: dict[str, Any] = {}
    for engine, simulation in simulations.items():
        simulation.close()
        figures |= {
            f"{engine}_overhead_ratio": median_ratio(core[engine], raw[engine]),
            f"{engine}_physics_steps_per_s": steps * conf.physics.substeps / float(np.median(raw[engine])),
            f"{engine}_core_steps_per_s": steps / float(np.median(core[engine])),
            f"{engine}_reset_ms": float(np.median(resets[engine])) / conf.scenes * 1e3,
        }
    return figures


def measure_terrain(conf: BenchmarkConf) -> dict[str, float]:
    """Millions of points per second of each query on one core, at random points of the world."""
    world = build_world(conf.world)
    xmin, xmax, ymin, ymax = world.extent
    xy = np.random.default_rng(conf.seed).uniform([xmin, ymin], [xmax, ymax], (_POINTS, 2))
    queries = {
        "height": world.terrain.height,
        "normal": world.terrain.normal,
        "slope": world.terrain.slope,
        "roughness": world.roughness,
        "clearance": world.clearance,
        "nearest_obstacle": world.nearest_obstacle,
    }
    for query in queries.values():
        query(xy)
    times = time_in_turns({name: (partial(query, xy), 1) for name, query in queries.items()}, conf.rounds)
    return {
        f"terrain_{name}_mpoints_per_s": _POINTS / float(np.median(values)) / 1e6
        for name, values in times.items()
    }
