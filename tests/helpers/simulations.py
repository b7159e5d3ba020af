"""Simulations in true physics, for tests."""

from typing import Any

import numpy as np

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation


def simulation(
    world: str = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any
) -> VectorSimulation:
    """A simulation at the start of its first episodes, without walkers unless `settings` have them."""
    conf = compose_environment(world, (), {"actors": "none"} | settings)
    made = make_simulation(conf, num_scenes, seed)
    made.reset()
    return made


def rest(made: VectorSimulation) -> dict[str, np.ndarray]:
    """Actions of zeros for all agents."""
    return {
        group.name: np.zeros((made.num_scenes, group.count, group.action_size), np.float32)
        for group in made.external
    }
