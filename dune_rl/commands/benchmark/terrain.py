"""Throughput of queries about the ground."""

from functools import partial

import numpy as np

from dune_rl.commands.benchmark.timing import time_in_turns
from dune_rl.config.build import build_world
from dune_rl.config.commands import BenchmarkConf

_POINTS = 100_000


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
