"""Cost of entering another world of the same family."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from dune_rl.commands.benchmark.timing import time_calls
from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.commands import BenchmarkConf

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
