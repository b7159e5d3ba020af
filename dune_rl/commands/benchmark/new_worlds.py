"""Time and memory that new worlds of a family take."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from dune_rl.commands.benchmark.measuring import RandomActions, resident_memory_mib, time_calls
from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.core.errors import ConfigError
from dune_rl.env.simulation import VectorSimulation

_MOST_WORLDS = 5


def measure_new_world(conf: BenchmarkConf) -> dict[str, float]:
    """Median times [ms] from the settings of a world until one scene of it has been reset and observed.

    `fresh_ms` for a world that was never built before, `kept_ms` for one in the disk cache; `build_ms` and
    `load_ms` are the parts of these that make the world itself.
    """
    times: dict[str, list[float]] = {"build": [], "fresh": [], "load": [], "kept": []}
    with _empty_cache():
        for number in range(1, 1 + min(conf.rounds, _MOST_WORLDS)):
            world = conf.world
            if hasattr(world, "seed"):
                world = world.model_copy(update={"seed": (world.seed + number) % 2**32})
            there = conf.model_copy(update={"world": world})
            for part, whole in (("build", "fresh"), ("load", "kept")):
                build_world.cache_clear()
                times[part].append(time_calls(partial(build_world, world), 1))
                times[whole].append(times[part][-1] + time_calls(partial(_reset_and_observe, there), 1))
    build_world.cache_clear()
    return {f"{name}_ms": float(np.median(values)) * 1e3 for name, values in times.items()}


def _reset_and_observe(conf: BenchmarkConf) -> None:
    simulation = make_simulation(conf, 1, conf.seed)
    simulation.reset()
    for group in simulation.external:
        group.observe()
    simulation.close()


@contextmanager
def _empty_cache() -> Iterator[None]:
    usual = os.environ.get("DUNE_RL_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DUNE_RL_CACHE"] = folder
        try:
            yield
        finally:
            if usual is None:
                del os.environ["DUNE_RL_CACHE"]
            else:
                os.environ["DUNE_RL_CACHE"] = usual


# Worlds after which a process holds what it will hold: buffers, pools and compiled code.
_SETTLED = 50
_SCENES = 2
_STEPS = 5
_MOST_SEED = 1_000_000


def measure_world_memory(
    conf: BenchmarkConf, resident: Callable[[], float] = resident_memory_mib
) -> dict[str, float]:
    """Resident memory [MiB] as `conf.worlds` new worlds are entered by two scenes, a few steps in each.

    The ratio is the largest of the second half of the worlds to the largest of the first half, without the
    first 50: both halves see worlds of all sizes, so that it is 1 unless what has been left stays.
    """
    if not hasattr(conf.world, "seed"):
        raise ConfigError(f"world={conf.world.name} has no seed, so there are no new worlds to enter")
    if conf.worlds < 2 * _SETTLED:
        raise ConfigError(f"worlds must be at least {2 * _SETTLED} (got {conf.worlds})")
    drawn = {"world_seed": {"name": "integers", "low": 1000, "high": _MOST_SEED}}
    there = BenchmarkConf.model_validate({**conf.model_dump(), "randomisation": drawn})
    simulation = make_simulation(there, _SCENES, conf.seed)
    actions = RandomActions(simulation)
    seen: list[float] = []
    for _ in range(-(-conf.worlds // _SCENES)):
        _enter_worlds(simulation, actions)
        seen.append(resident())
    simulation.close()
    settled = np.array(seen[_SETTLED // _SCENES :])
    first, second = np.array_split(settled, 2)
    return {
        "worlds": len(seen) * _SCENES,
        "memory_mib_after_50_worlds": float(settled[0]),
        "memory_mib_first_half": float(first.max()),
        "memory_mib_second_half": float(second.max()),
        "new_worlds_memory_ratio": float(second.max() / first.max()),
    }


def _enter_worlds(simulation: VectorSimulation, actions: RandomActions) -> None:
    simulation.reset()
    for _ in range(_STEPS):
        simulation.step(actions.draw())
        for group in simulation.external:
            group.observe()
