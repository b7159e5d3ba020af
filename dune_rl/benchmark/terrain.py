"""How many points a second are told about the ground."""

from functools import partial

import numpy as np

from dune_rl.benchmark.environment import seconds
from dune_rl.config.build import build_world
from dune_rl.config.schema import BenchmarkConf

_POINTS = 100_000


def measure_terrain(conf: BenchmarkConf) -> dict[str, float]:
    """Millions of points a second of each query, on one core, at points all over the world."""
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
    taken: dict[str, list[float]] = {name: [] for name in queries}
    for query in queries.values():
        query(xy)
    for _ in range(conf.rounds):
        for name, query in queries.items():
            taken[name].append(seconds(partial(query, xy), 1))
    return {
        f"terrain_{name}_mpoints_per_s": _POINTS / float(np.median(times)) / 1e6
        for name, times in taken.items()
    }
