"""Cost of the physics engines, alone and within a control step."""

from functools import partial
from typing import Any

import numpy as np
import torch

from dune_rl.commands.benchmark.steppers import core_stepper
from dune_rl.commands.benchmark.timing import median_ratio, time_calls
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.physics.interface import ENGINES

_WARM_UP = 50


def measure_engines(conf: BenchmarkConf) -> dict[str, Any]:
    """Physics and control steps per second of each engine and its overhead, in alternating rounds."""
    torch.set_num_threads(1)
    simulations, cores = {}, {}
    for engine in ENGINES:
        data = conf.model_dump()
        data["physics"] |= {"backend": engine}
        simulations[engine] = make_simulation(BenchmarkConf.model_validate(data), conf.scenes, conf.seed)
        simulations[engine].reset()
        cores[engine] = core_stepper(simulations[engine])
        time_calls(cores[engine], _WARM_UP)
        time_calls(simulations[engine].step_passive, _WARM_UP)
    core: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    raw: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    resets: dict[str, list[float]] = {engine: [] for engine in ENGINES}
    mask = np.ones(conf.scenes, bool)
    for _ in range(conf.rounds):
        for engine, simulation in simulations.items():
            core[engine].append(time_calls(cores[engine], conf.steps))
            raw[engine].append(time_calls(simulation.step_passive, conf.steps))
            resets[engine].append(time_calls(partial(simulation.reset, mask), 1))
    steps = conf.steps * conf.scenes
    figures: dict[str, Any] = {}
    for engine, simulation in simulations.items():
        simulation.close()
        figures |= {
            f"{engine}_overhead_ratio": median_ratio(core[engine], raw[engine]),
            f"{engine}_physics_steps_per_s": steps * conf.physics.substeps / float(np.median(raw[engine])),
            f"{engine}_core_steps_per_s": steps / float(np.median(core[engine])),
            f"{engine}_reset_ms": float(np.median(resets[engine])) / conf.scenes * 1e3,
        }
    return figures
