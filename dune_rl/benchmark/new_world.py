"""What it costs to go to another world of the family."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from dune_rl.benchmark.environment import seconds
from dune_rl.config.build import build_world, make_batch
from dune_rl.config.schema import BenchmarkConf

_MOST_WORLDS = 5


def measure_new_world(conf: BenchmarkConf) -> dict[str, float]:
    """Times [ms] from the settings of a world until one scene of it has been reset and observed; medians.

    `fresh_ms` where it was never built before, `kept_ms` where it was, and `build_ms` and `load_ms` are the
    parts of these that give the world itself.
    """
    taken: dict[str, list[float]] = {"build": [], "fresh": [], "load": [], "kept": []}
    with _empty_cache():
        for number in range(1, 1 + min(conf.rounds, _MOST_WORLDS)):
            world = conf.world
            if hasattr(world, "seed"):
                world = world.model_copy(update={"seed": (world.seed + number) % 2**32})
            there = conf.model_copy(update={"world": world})
            for part, whole in (("build", "fresh"), ("load", "kept")):
                build_world.cache_clear()
                taken[part].append(seconds(partial(build_world, world), 1))
                taken[whole].append(taken[part][-1] + seconds(partial(_reset, there), 1))
    build_world.cache_clear()
    return {f"{name}_ms": float(np.median(times)) * 1e3 for name, times in taken.items()}


def _reset(conf: BenchmarkConf) -> None:
    batch = make_batch(conf, 1, conf.seed)
    batch.reset()
    batch.observe()
    batch.close()


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
