"""What a step costs: `python -m dune_rl.benchmark` prints JSON lines.

All ratios come from one run on one core, in rounds that alternate between the
things compared, so that a noisy machine disturbs them alike.
"""

import json
import multiprocessing
import resource
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dune_rl import command
from dune_rl.command import Page
from dune_rl.config.build import make_batch, make_parallel_env, make_torchrl_env
from dune_rl.config.compose import compose_benchmark
from dune_rl.config.schema import BenchmarkConf
from dune_rl.env.batch import Batch

_WARM_UP = 50

USAGE = (
    ("python -m dune_rl.benchmark", "inspection, two walkers"),
    ("python -m dune_rl.benchmark world=flat actors=none", "another one"),
)
SETTINGS = (
    ("scenes=N", "stepped as one batch"),
    ("rounds=N", "in each, everything that is compared takes its turn"),
    ("steps=N", "of every scene in a turn"),
    ("processes=[1,2]", "how many batch cores to run at once, one after the other"),
)
CLOSING = "Ratios compare things within one run, so that they hold on a busy machine too."


def _emit(**values: Any) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def _seconds(action: Callable[[], None], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        action()
    return time.perf_counter() - start


class _Driver:
    """Random commands, the same for everything that is compared, drawn before the clock starts."""

    def __init__(self, scenes: int, seed: int = 0) -> None:
        draws = np.random.default_rng(seed)
        low, high = [-1.0, -np.pi], [1.0, np.pi]
        self._actions = draws.uniform(low, high, (64, scenes, 2)).astype(np.float32)
        self._turn = 0

    def next(self) -> np.ndarray:
        """The next actions, (scenes, 2)."""
        self._turn += 1
        return self._actions[self._turn % len(self._actions)]


def _core_step(batch: Batch, driver: _Driver) -> None:
    outcome = batch.step(driver.next())
    batch.observe()
    done = outcome.terminated | outcome.truncated
    if done.any():
        batch.reset(done)


def _torchrl_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    env = make_torchrl_env(conf, conf.scenes, conf.seed)
    driver = _Driver(conf.scenes)
    state = {"now": env.reset()}

    def step() -> None:
        now = state["now"].set("action", torch.from_numpy(driver.next()))
        _, state["now"] = env.step_and_maybe_reset(now)

    return step


def _pettingzoo_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    env = make_parallel_env(conf, conf.seed)
    driver = _Driver(1)
    env.reset()

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step({"rover_0": driver.next()[0]})

    return step


def _median_ratio(numerators: list[float], denominators: list[float]) -> float:
    return float(np.median(np.array(numerators) / np.array(denominators)))


def _peak_memory_mib() -> float:
    # Linux's getrusage gives a spawned process its parent's peak; the status file knows its own.
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return int(lines["VmHWM"].split()[0]) / 1024
    scale = 1024 if sys.platform != "darwin" else 1024**2
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale


def measure(conf: BenchmarkConf) -> dict[str, Any]:
    """Costs of one process on one core: per-scene times [µs], steps per second, and their ratios."""
    torch.set_num_threads(1)
    batch = make_batch(conf, conf.scenes, conf.seed)
    batch.reset()
    driver = _Driver(conf.scenes)
    core = partial(_core_step, batch, driver)
    torchrl = _torchrl_stepper(conf)
    pettingzoo = _pettingzoo_stepper(conf)
    steppers: dict[str, tuple[Callable[[], None], int]] = {
        "core": (core, conf.scenes),
        "raw": (batch.coast, conf.scenes),
        "torchrl": (torchrl, conf.scenes),
        "pettingzoo": (pettingzoo, 1),
    }
    for step, scenes in steppers.values():
        _seconds(step, _WARM_UP * conf.scenes // scenes)
    per_scene: dict[str, list[float]] = {name: [] for name in steppers}
    for _ in range(conf.rounds):
        for name, (step, scenes) in steppers.items():
            count = max(1, conf.steps * conf.scenes // scenes)
            per_scene[name].append(_seconds(step, count) / count / scenes)
    mask = np.ones(conf.scenes, bool)
    resets = [_seconds(partial(batch.reset, mask), 1) / conf.scenes for _ in range(conf.rounds)]
    median = {name: float(np.median(values)) for name, values in per_scene.items()}
    return {
        "scenes": conf.scenes,
        "overhead_ratio": _median_ratio(per_scene["core"], per_scene["raw"]),
        "torchrl_ratio": _median_ratio(per_scene["core"], per_scene["torchrl"]),
        "pettingzoo_ratio": _median_ratio(per_scene["core"], per_scene["pettingzoo"]),
        "raw_physics_step_us": median["raw"] / conf.physics.substeps * 1e6,
        "raw_steps_per_s": 1.0 / median["raw"],
        "core_steps_per_s": 1.0 / median["core"],
        "torchrl_steps_per_s": 1.0 / median["torchrl"],
        "pettingzoo_steps_per_s": 1.0 / median["pettingzoo"],
        "times_real_time": conf.physics.control_step_s / median["core"],
        "reset_ms": float(np.median(resets)) * 1e3,
        "peak_memory_mib": _peak_memory_mib(),
    }


def _worker(conf: BenchmarkConf, seed: int, barrier: Any, results: Any) -> None:
    torch.set_num_threads(1)
    batch = make_batch(conf, conf.scenes, seed)
    batch.reset()
    step = partial(_core_step, batch, _Driver(conf.scenes))
    _seconds(step, _WARM_UP)
    barrier.wait()
    count = conf.steps * conf.rounds
    results.put((count * conf.scenes / _seconds(step, count), _peak_memory_mib()))


def measure_processes(conf: BenchmarkConf, processes: int) -> dict[str, Any]:
    """Steps per second of `processes` batch cores at once, and the memory of the largest [MiB]."""
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(processes), context.Queue()
    workers = [
        context.Process(target=_worker, args=(conf, conf.seed + index, barrier, results))
        for index in range(processes)
    ]
    for worker in workers:
        worker.start()
    found = [results.get() for _ in workers]
    for worker in workers:
        worker.join()
    return {
        "processes": processes,
        "scenes_each": conf.scenes,
        "core_steps_per_s": sum(speed for speed, _ in found),
        "peak_memory_mib_each": max(memory for _, memory in found),
    }


def main() -> None:
    """Run the command line; ends the process."""
    command.run(Page("Measure what a step costs; JSON lines.", USAGE, SETTINGS, CLOSING), _main)


def _main(parsed: Namespace) -> None:
    conf = compose_benchmark(parsed.overrides, command.config_dirs(parsed))
    _emit(benchmark="environment", world=conf.world.name, actors=len(conf.actors), **measure(conf))
    for processes in conf.processes:
        _emit(benchmark="processes", world=conf.world.name, **measure_processes(conf, processes))


if __name__ == "__main__":
    main()
