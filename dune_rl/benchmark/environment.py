"""What a step of an environment costs, in comparison with its bare physics."""

import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dune_rl.config.build import build_robot, make_batch, make_parallel_env, make_torchrl_env
from dune_rl.config.schema import BenchmarkConf
from dune_rl.env.batch import Batch
from dune_rl.robots.robot import Robot

_WARM_UP = 50
_SPEED_AND_HEADING = 2
# Of a joint's range, either way.
_SWAY = 0.05


def seconds(action: Callable[[], object], count: int) -> float:
    """Time that `action` takes, called `count` times [s]."""
    start = time.perf_counter()
    for _ in range(count):
        action()
    return time.perf_counter() - start


class _Driver:
    """Random commands, the same for everything that is compared, drawn before the clock starts.

    Speeds and headings are any that the robot takes; joints' angles are near those that it stands by.
    """

    def __init__(self, robot: Robot, scenes: int, seed: int = 0) -> None:
        low, high = robot.action_bounds()
        if len(low) != _SPEED_AND_HEADING:
            # With wilder ones a robot falls at once, and resets are what would be measured.
            rest, sway = robot.rest_action(), _SWAY * (high - low)
            low, high = np.maximum(low, rest - sway), np.minimum(high, rest + sway)
        draws = np.random.default_rng(seed)
        self._actions = draws.uniform(low, high, (64, scenes, len(low))).astype(np.float32)
        self._turn = 0

    def next(self) -> np.ndarray:
        """The next actions, (scenes, A)."""
        self._turn += 1
        return self._actions[self._turn % len(self._actions)]


def _core_step(batch: Batch, driver: _Driver) -> None:
    outcome = batch.step(driver.next())
    batch.observe()
    done = outcome.terminated | outcome.truncated
    if done.any():
        batch.reset(done)


def core_stepper(batch: Batch) -> Callable[[], None]:
    """A step of all scenes under random commands, observations and new episodes included."""
    return partial(_core_step, batch, _Driver(batch.robot, batch.num_scenes))


def _torchrl_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    env = make_torchrl_env(conf, conf.scenes, conf.seed)
    driver = _Driver(env.batch.robot, conf.scenes)
    state = {"now": env.reset()}

    def step() -> None:
        now = state["now"].set("action", torch.from_numpy(driver.next()))
        _, state["now"] = env.step_and_maybe_reset(now)

    return step


def _pettingzoo_stepper(conf: BenchmarkConf) -> Callable[[], None]:
    env = make_parallel_env(conf, conf.seed)
    driver = _Driver(build_robot(conf.robot, 1), 1)
    env.reset()

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step({"rover_0": driver.next()[0]})

    return step


def median_ratio(numerators: list[float], denominators: list[float]) -> float:
    """Middle one of the ratios of times taken in turn."""
    return float(np.median(np.array(numerators) / np.array(denominators)))


def measure_overhead(conf: BenchmarkConf, outputs: tuple[str, ...]) -> dict[str, float]:
    """What a step costs with a camera of `outputs` beside LiDAR, IMU and goal, as a ratio to bare physics."""
    sensors = {"enabled": ["camera", "lidar", "imu", "goal"], "camera": {"outputs": outputs}}
    seeing = BenchmarkConf.model_validate({**conf.model_dump(), "sensors": sensors})
    batch = make_batch(seeing, conf.scenes, conf.seed)
    batch.reset()
    core = core_stepper(batch)
    seconds(core, _WARM_UP)
    seconds(batch.coast, _WARM_UP)
    taken: dict[str, list[float]] = {"core": [], "raw": []}
    for _ in range(conf.rounds):
        taken["core"].append(seconds(core, conf.steps))
        taken["raw"].append(seconds(batch.coast, conf.steps))
    batch.close()
    return {
        "overhead_ratio": median_ratio(taken["core"], taken["raw"]),
        "core_steps_per_s": conf.steps * conf.scenes / float(np.median(taken["core"])),
    }


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
    core = core_stepper(batch)
    torchrl = _torchrl_stepper(conf)
    pettingzoo = _pettingzoo_stepper(conf)
    steppers: dict[str, tuple[Callable[[], None], int]] = {
        "core": (core, conf.scenes),
        "raw": (batch.coast, conf.scenes),
        "torchrl": (torchrl, conf.scenes),
        "pettingzoo": (pettingzoo, 1),
    }
    for step, scenes in steppers.values():
        seconds(step, _WARM_UP * conf.scenes // scenes)
    per_scene: dict[str, list[float]] = {name: [] for name in steppers}
    for _ in range(conf.rounds):
        for name, (step, scenes) in steppers.items():
            count = max(1, conf.steps * conf.scenes // scenes)
            per_scene[name].append(seconds(step, count) / count / scenes)
    mask = np.ones(conf.scenes, bool)
    resets = [seconds(partial(batch.reset, mask), 1) / conf.scenes for _ in range(conf.rounds)]
    median = {name: float(np.median(values)) for name, values in per_scene.items()}
    return {
        "scenes": conf.scenes,
        "overhead_ratio": median_ratio(per_scene["core"], per_scene["raw"]),
        "torchrl_ratio": median_ratio(per_scene["core"], per_scene["torchrl"]),
        "pettingzoo_ratio": median_ratio(per_scene["core"], per_scene["pettingzoo"]),
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
    step = core_stepper(batch)
    seconds(step, _WARM_UP)
    barrier.wait()
    count = conf.steps * conf.rounds
    results.put((count * conf.scenes / seconds(step, count), _peak_memory_mib()))


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
