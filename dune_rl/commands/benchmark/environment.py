"""Cost of a control step, compared with its bare physics."""

import multiprocessing
from functools import partial
from typing import Any

import numpy as np
import torch

from dune_rl.commands.benchmark.measuring import (
    core_stepper,
    gymnasium_vector_stepper,
    median_ratio,
    peak_memory_mib,
    pettingzoo_stepper,
    time_calls,
    time_in_turns,
    torchrl_stepper,
)
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import BenchmarkConf

_WARM_UP = 50


def measure_overhead(conf: BenchmarkConf, outputs: tuple[str, ...]) -> dict[str, float]:
    """Cost of a step with a camera of `outputs` besides LiDAR, IMU and goal, relative to bare physics."""
    sensors = {"enabled": ["camera", "lidar", "imu", "goal"], "camera": {"outputs": outputs}}
    with_camera = BenchmarkConf.model_validate({**conf.model_dump(), "sensors": sensors})
    simulation = make_simulation(with_camera, conf.scenes, conf.seed)
    simulation.reset()
    core = core_stepper(simulation)
    time_calls(core, _WARM_UP)
    time_calls(simulation.step_passive, _WARM_UP)
    steps = {"core": (core, conf.steps), "raw": (simulation.step_passive, conf.steps)}
    times = time_in_turns(steps, conf.rounds)
    simulation.close()
    return {
        "overhead_ratio": median_ratio(times["core"], times["raw"]),
        "core_steps_per_s": conf.scenes / float(np.median(times["core"])),
    }


def measure_environment(conf: BenchmarkConf) -> dict[str, Any]:
    """Cost of one process on one core: steps of a scene per second, and ratios between the interfaces.

    Gymnasium's vector environment is among them where a scene has one external agent. `agents` is the number
    of external agents in a scene, and `core_agent_steps_per_s` counts each of them.
    """
    torch.set_num_threads(1)
    simulation = make_simulation(conf, conf.scenes, conf.seed)
    simulation.reset()
    # The environments are built after the core, whose memory is thus the first in place.
    core, torchrl, pettingzoo = core_stepper(simulation), torchrl_stepper(conf), pettingzoo_stepper(conf)
    single = conf.steps * conf.scenes
    steppers = {
        "core": (core, conf.steps),
        "raw": (simulation.step_passive, conf.steps),
        "torchrl": (torchrl, conf.steps),
        "metrics": (torchrl_stepper(conf, metrics=True), conf.steps),
        "pettingzoo": (pettingzoo, single),
    }
    if len(simulation.agents) == 1:
        steppers["gymnasium_vector"] = gymnasium_vector_stepper(conf), conf.steps
    for name, (step, _) in steppers.items():
        time_calls(step, _WARM_UP * (conf.scenes if name == "pettingzoo" else 1))
    per_scene = {
        name: [time / (1 if name == "pettingzoo" else conf.scenes) for time in times]
        for name, times in time_in_turns(steppers, conf.rounds).items()
    }
    mask = np.ones(conf.scenes, bool)
    resets = [time_calls(partial(simulation.reset, mask), 1) / conf.scenes for _ in range(conf.rounds)]
    median = {name: float(np.median(values)) for name, values in per_scene.items()}
    agents = len(simulation.agents)
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
        "reset_ms": float(np.median(resets)) * 1e3,
        "peak_memory_mib": peak_memory_mib(),
    }
    if "gymnasium_vector" in per_scene:
        found["gymnasium_vector_ratio"] = median_ratio(per_scene["core"], per_scene["gymnasium_vector"])
        found["gymnasium_vector_steps_per_s"] = 1.0 / median["gymnasium_vector"]
    return found


def _worker(conf: BenchmarkConf, seed: int, barrier: Any, results: Any) -> None:
    torch.set_num_threads(1)
    simulation = make_simulation(conf, conf.scenes, seed)
    simulation.reset()
    step = core_stepper(simulation)
    time_calls(step, _WARM_UP)
    barrier.wait()
    count = conf.steps * conf.rounds
    results.put((count * conf.scenes / time_calls(step, count), peak_memory_mib()))


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
    measured = [results.get() for _ in workers]
    for worker in workers:
        worker.join()
    return {
        "processes": processes,
        "scenes_each": conf.scenes,
        "core_steps_per_s": sum(speed for speed, _ in measured),
        "peak_memory_mib_each": max(memory for _, memory in measured),
    }
