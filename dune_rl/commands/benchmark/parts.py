"""The parts of the benchmark: steps, cameras, groups, actors, engines, processes, terrain and new worlds."""

import multiprocessing
import os
import tempfile
from collections.abc import Mapping
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
import torch

from dune_rl.commands.benchmark.measuring import (
    RandomActions,
    Step,
    core_stepper,
    gymnasium_vector_stepper,
    median_ratio,
    memory_mib,
    observe,
    pettingzoo_stepper,
    start_simulation,
    time_calls,
    time_in_turns,
    torchrl_stepper,
)
from dune_rl.config.build import build_world
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.shorthands import replace_actors
from dune_rl.core.errors import ConfigError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.physics.interface import OWN_ENGINES

_WARM_UP = 50
_ROBOTS, _ACTORS, _POINTS = 4, 20, 100_000
# The field of the result, and the controller of the actors.
_CONTROLLERS = {
    "actors_cost": "path",
    "actors_cost_social_force": "social_force",
    "actors_cost_orca": "orca",
}
_NEW_WORLDS = 5
# Worlds after which a process holds what it will hold: buffers, pools and compiled code.
_SETTLED = 50
_MEMORY_SCENES, _MEMORY_STEPS, _MOST_SEED = 2, 5, 1_000_000


def _changed(conf: BenchmarkConf, **sections: Any) -> BenchmarkConf:
    return BenchmarkConf.model_validate({**conf.model_dump(), **sections})


def _time_and_close(simulations: Mapping[str, VectorSimulation], conf: BenchmarkConf) -> dict[str, Array]:
    """Times [s] of control steps, "core NAME", of bare physics, "raw NAME", and of resets, "reset NAME"."""
    torch.set_num_threads(1)
    steps: dict[str, Step] = {}
    for name, simulation in simulations.items():
        steps |= {f"core {name}": core_stepper(simulation), f"raw {name}": simulation.step_passive}
    times = time_in_turns(steps, conf.rounds, conf.steps, _WARM_UP)
    times |= time_in_turns({f"reset {name}": _reset(each) for name, each in simulations.items()}, conf.rounds)
    for simulation in simulations.values():
        simulation.close()
    return times


def _reset(simulation: VectorSimulation) -> Step:
    return partial(simulation.reset, np.ones(simulation.num_scenes, bool))


def _median(times: Array | list[float]) -> float:
    return float(np.median(times))


def measure_environment(conf: BenchmarkConf) -> dict[str, Any]:
    """Cost of one process on one core: steps of a scene per second, and ratios between the interfaces.

    Gymnasium's vector environment is among them where a scene has one external agent. `agents` is the number
    of external agents in a scene, and `core_agent_steps_per_s` counts each of them.
    """
    torch.set_num_threads(1)
    simulation = start_simulation(conf)
    agents = len(simulation.agents)
    # The environments are built after the core, whose memory is thus the first in place.
    steppers = {
        "core": core_stepper(simulation),
        "raw": simulation.step_passive,
        "torchrl": torchrl_stepper(conf),
        "metrics": torchrl_stepper(conf, metrics=True),
        "pettingzoo": pettingzoo_stepper(conf),
    }
    if agents == 1:
        steppers["gymnasium_vector"] = gymnasium_vector_stepper(conf)
    # PettingZoo's has one scene.
    scenes = {name: 1 if name == "pettingzoo" else conf.scenes for name in steppers}
    counts = {name: conf.steps * conf.scenes // scenes[name] for name in steppers}
    times = time_in_turns(steppers, conf.rounds, counts, _WARM_UP)
    per_scene = {name: values / scenes[name] for name, values in times.items()}
    median = {name: _median(values) for name, values in per_scene.items()}
    resets = time_in_turns({"reset": _reset(simulation)}, conf.rounds)["reset"]
    simulation.close()
    found = {
        "scenes": conf.scenes,
        "agents": agents,
        "overhead_ratio": median_ratio(per_scene["core"], per_scene["raw"]),
        "torchrl_ratio": median_ratio(per_scene["core"], per_scene["torchrl"]),
        "metrics_ratio": median_ratio(per_scene["torchrl"], per_scene["metrics"]),
        "pettingzoo_ratio": median_ratio(per_scene["core"], per_scene["pettingzoo"]),
        "raw_physics_step_us": median["raw"] / conf.physics.substeps * 1e6,
        "raw_steps_per_s": 1.0 / median["raw"],
        "core_steps_per_s": 1.0 / median["core"],
        "core_agent_steps_per_s": agents / median["core"],
        "torchrl_steps_per_s": 1.0 / median["torchrl"],
        "pettingzoo_steps_per_s": 1.0 / median["pettingzoo"],
        "times_real_time": conf.physics.control_step_s / median["core"],
        "reset_ms": _median(resets) / conf.scenes * 1e3,
        "peak_memory_mib": memory_mib(peak=True),
    }
    if "gymnasium_vector" in per_scene:
        found["gymnasium_vector_ratio"] = median_ratio(per_scene["core"], per_scene["gymnasium_vector"])
        found["gymnasium_vector_steps_per_s"] = 1.0 / median["gymnasium_vector"]
    return found


def measure_cameras(conf: BenchmarkConf) -> dict[str, float]:
    """Cost of a step with a camera of colours, and of depths, besides LiDAR, IMU and goal."""
    found = {}
    for name, output in (("camera", "rgb"), ("depth", "depth")):
        sensors = {"enabled": ["camera", "lidar", "imu", "goal"], "camera": {"outputs": (output,)}}
        times = _time_and_close({name: start_simulation(_changed(conf, sensors=sensors))}, conf)
        found[f"overhead_ratio_{name}"] = median_ratio(times[f"core {name}"], times[f"raw {name}"])
        found[f"{name}_steps_per_s"] = conf.scenes / _median(times[f"core {name}"])
    return found


def measure_groups(conf: BenchmarkConf) -> dict[str, Any]:
    """Overhead of four equal robots per scene, as a ratio to that of one robot in the same world.

    Overhead is the time of a control step beyond that of its bare physics: sensors, control, rewards, resets
    and bookkeeping. The robot is the one of the first external group; the scenes have no other agents.
    """
    body = conf.external_groups[0].body
    counts = {"one_robot": 1, "four_robots": _ROBOTS}
    simulations = {
        name: start_simulation(_changed(conf, agents={"rover": {"body": body, "count": count}}))
        for name, count in counts.items()
    }
    times = _time_and_close(simulations, conf)
    overhead = {name: _median(times[f"core {name}"] - times[f"raw {name}"]) for name in counts}
    found: dict[str, Any] = {
        "scenes": conf.scenes,
        "four_robots_overhead_ratio": overhead["four_robots"] / overhead["one_robot"],
    }
    for name, count in counts.items():
        core = times[f"core {name}"]
        found[f"{name}_overhead_us"] = overhead[name] / conf.scenes * 1e6
        found[f"{name}_core_ratio"] = median_ratio(core, times[f"raw {name}"])
        found[f"{name}_agent_steps_per_s"] = conf.scenes * count / _median(core)
    return found


def measure_actors(conf: BenchmarkConf) -> dict[str, Any]:
    """What twenty persons beside the agents of `conf` add to a control step, as a share of it.

    Scripted ones walk on paths. They stand in the way of robots, so that physics has more contacts, and
    sensors see them: that is part of the cost.
    """
    agents = conf.model_dump()["agents"]
    simulations = {"none": start_simulation(_changed(conf, agents=replace_actors(agents, {})))}
    for name, controller in _CONTROLLERS.items():
        crowd = {"body": {"name": "person"}, "count": _ACTORS, "controller": controller}
        simulations[name] = start_simulation(_changed(conf, agents=replace_actors(agents, {"crowd": crowd})))
    torch.set_num_threads(1)
    # Without bare physics between, in which robots would drive on into the persons.
    steps = {name: core_stepper(simulation) for name, simulation in simulations.items()}
    times = time_in_turns(steps, conf.rounds, conf.steps, _WARM_UP)
    for simulation in simulations.values():
        simulation.close()
    costs = {name: median_ratio(times[name], times["none"]) - 1.0 for name in _CONTROLLERS}
    without_us = _median(times["none"]) / conf.scenes * 1e6
    return {"scenes": conf.scenes, "actors": _ACTORS, **costs, "step_without_actors_us": without_us}


def measure_engines(conf: BenchmarkConf) -> dict[str, Any]:
    """Physics and control steps per second of each engine and its overhead, in alternating rounds."""
    physics = conf.model_dump()["physics"]
    simulations = {
        engine: start_simulation(_changed(conf, physics={**physics, "backend": engine}))
        for engine in OWN_ENGINES
    }
    times = _time_and_close(simulations, conf)
    found: dict[str, Any] = {}
    for engine in simulations:
        core, raw = times[f"core {engine}"], times[f"raw {engine}"]
        physics_steps = conf.scenes * conf.physics.substeps
        found |= {
            f"{engine}_overhead_ratio": median_ratio(core, raw),
            f"{engine}_physics_steps_per_s": physics_steps / _median(raw),
            f"{engine}_core_steps_per_s": conf.scenes / _median(core),
            f"{engine}_reset_ms": _median(times[f"reset {engine}"]) / conf.scenes * 1e3,
        }
    return found


def _worker(conf: BenchmarkConf, seed: int, barrier: Any, results: Any) -> None:
    torch.set_num_threads(1)
    step = core_stepper(start_simulation(conf.model_copy(update={"seed": seed})))
    time_calls(step, _WARM_UP)
    barrier.wait()
    count = conf.steps * conf.rounds
    results.put((count * conf.scenes / time_calls(step, count), memory_mib(peak=True)))


def measure_processes(conf: BenchmarkConf, processes: int) -> dict[str, Any]:
    """Steps per second of `processes` cores at once, and the memory [MiB] of the largest process."""
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(processes), context.Queue()
    workers = [
        context.Process(target=_worker, args=(conf, conf.seed + index, barrier, results))
        for index in range(processes)
    ]
    for worker in workers:
        worker.start()
    speeds, memories = zip(*(results.get() for _ in workers), strict=True)
    for worker in workers:
        worker.join()
    return {
        "processes": processes,
        "scenes_each": conf.scenes,
        "core_steps_per_s": sum(speeds),
        "peak_memory_mib_each": max(memories),
    }


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
    times = time_in_turns(
        {name: partial(query, xy) for name, query in queries.items()}, conf.rounds, warm_up=1
    )
    return {f"terrain_{name}_mpoints_per_s": _POINTS / _median(each) / 1e6 for name, each in times.items()}


def measure_new_world(conf: BenchmarkConf) -> dict[str, float]:
    """Median times [ms] from the settings of a world until one scene of it has been reset and observed.

    `fresh_ms` for a world that was never built before, `kept_ms` for one in the disk cache; `build_ms` and
    `load_ms` are the parts of these that make the world itself.
    """
    times: dict[str, list[float]] = {"build": [], "fresh": [], "load": [], "kept": []}
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, DUNE_RL_CACHE=folder):
        for number in range(1, 1 + min(conf.rounds, _NEW_WORLDS)):
            world = conf.world
            if hasattr(world, "seed"):
                world = world.model_copy(update={"seed": (world.seed + number) % 2**32})
            there = conf.model_copy(update={"world": world})
            for part, whole in (("build", "fresh"), ("load", "kept")):
                build_world.cache_clear()
                times[part].append(time_calls(partial(build_world, world)))
                times[whole].append(times[part][-1] + time_calls(partial(_reset_and_observe, there)))
    build_world.cache_clear()
    return {f"{name}_ms": _median(values) * 1e3 for name, values in times.items()}


def _reset_and_observe(conf: BenchmarkConf) -> None:
    simulation = start_simulation(conf, 1)
    observe(simulation)
    simulation.close()


def measure_world_memory(conf: BenchmarkConf) -> dict[str, Any]:
    """Resident memory [MiB] as `conf.worlds` new worlds are entered by two scenes, a few steps in each.

    The ratio is the largest of the second half of the worlds to the largest of the first half, without the
    first 50: both halves see worlds of all sizes, so that it is 1 unless what has been left stays.
    """
    if not hasattr(conf.world, "seed"):
        raise ConfigError(f"world={conf.world.name} has no seed, so there are no new worlds to enter")
    if conf.worlds < 2 * _SETTLED:
        raise ConfigError(f"worlds must be at least {2 * _SETTLED} (got {conf.worlds})")
    drawn = {"world_seed": {"name": "integers", "low": 1000, "high": _MOST_SEED}}
    simulation = start_simulation(_changed(conf, randomisation=drawn), _MEMORY_SCENES)
    actions = RandomActions(simulation)
    seen: list[float] = []
    for _ in range(-(-conf.worlds // _MEMORY_SCENES)):
        simulation.reset()
        for _ in range(_MEMORY_STEPS):
            simulation.step(actions.draw())
            observe(simulation)
        seen.append(memory_mib())
    simulation.close()
    settled = np.array(seen[_SETTLED // _MEMORY_SCENES :])
    first, second = (float(half.max()) for half in np.array_split(settled, 2))
    return {
        "engine": conf.physics.backend,
        "worlds": len(seen) * _MEMORY_SCENES,
        "memory_mib_after_50_worlds": float(settled[0]),
        "memory_mib_first_half": first,
        "memory_mib_second_half": second,
        "new_worlds_memory_ratio": second / first,
    }
