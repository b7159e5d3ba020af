"""What it costs to go to another world of the family."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from dune_rl.benchmark.environment import seconds
from dune_rl.config.build import build_world, make_batch
from dune_rl.config.schema import BenchmarkConf
from dune_rl.worlds.store import WorldStore

_MOST_WORLDS = 5


def measure_new_world(conf: BenchmarkConf) -> dict[str, float]:
    """Times [ms] for a world that was never seen before, medians over several.

    `build_ms` is to generate it, `load_ms` to read it where it has been kept, and `ready_ms` all the rest
    until one scene of it has been reset and observed.
    """
    taken: dict[str, list[float]] = {"build": [], "load": [], "ready": []}
    with tempfile.TemporaryDirectory() as folder:
        store = WorldStore(Path(folder))
        for number in range(1, 1 + min(conf.rounds, _MOST_WORLDS)):
            world = conf.world
            if hasattr(world, "seed"):
                world = world.model_copy(update={"seed": (world.seed + number) % 2**32})
            taken["build"].append(seconds(partial(store.get, world), 1))
            taken["load"].append(seconds(partial(store.get, world), 1))
            build_world(world)
            taken["ready"].append(seconds(partial(_reset, conf.model_copy(update={"world": world})), 1))
    return {f"{name}_ms": float(np.median(times)) * 1e3 for name, times in taken.items()}


def _reset(conf: BenchmarkConf) -> None:
    batch = make_batch(conf, 1, conf.seed)
    batch.reset()
    batch.observe()
    batch.close()
