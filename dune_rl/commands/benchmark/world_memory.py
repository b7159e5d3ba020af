"""Memory of a process that enters ever new worlds."""

from collections.abc import Callable

import numpy as np

from dune_rl.commands.benchmark.steppers import RandomActions
from dune_rl.commands.benchmark.timing import resident_memory_mib
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import BenchmarkConf
from dune_rl.core.errors import ConfigError
from dune_rl.env.simulation import VectorSimulation

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
