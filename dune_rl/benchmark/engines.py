"""What the physics engines cost, beside each other and below the rest of a step."""

from functools import partial
from typing import Any

import numpy as np
import torch

from dune_rl.benchmark.environment import core_stepper, median_ratio, seconds
from dune_rl.config.build import make_batch
from dune_rl.config.schema import BenchmarkConf
from dune_rl.physics.interface import ENGINES

_WARM_UP = 50


def measure_engines(conf: BenchmarkConf) -> dict[str, Any]:
    """Physics and control steps per second of each engine, and its overhead, in rounds that alternate."""
    torch.set_num_threads(1)
    batches, cores = {}, {}
    for engine in ENGINES:
        data = conf.model_dump()
        data["physics"] |= {"backend": engine}
        batches[engine] = make_batch(BenchmarkConf.model_validate(data), conf.scenes, conf.seed)
        batches[engine].reset()
        cores[engine] = core_stepper(batches[engine])
        seconds(cores[engine], _WARM_UP)
        seconds(batches[engine].coast, _WARM_UP)
    core: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    raw: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    resets: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    mask = np.ones(conf.scenes, bool)
    for _ in range(conf.rounds):
        for engine, batch in batches.items():
            core[engine].append(seconds(cores[engine], conf.steps))
            raw[engine].append(seconds(batch.coast, conf.steps))
            resets[engine].append(seconds(partial(batch.reset, mask), 1))
    steps = conf.steps * conf.scenes
    found: dict[str, Any] = {}
    for engine, batch in batches.items():
        batch.close()
        found |= {
            f"{engine}_overhead_ratio": median_ratio(core[engine], raw[engine]),
            f"{engine}_physics_steps_per_s": steps * conf.physics.substeps / float(np.median(raw[engine])),
            f"{engine}_core_steps_per_s": steps / float(np.median(core[engine])),
            f"{engine}_reset_ms": float(np.median(resets[engine])) / conf.scenes * 1e3,
        }
    return found
