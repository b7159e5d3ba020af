"""Worlds built from mesh files, for tests."""

from simulations import simulation_on

from dune_rl.env.simulation import VectorSimulation
from dune_rl.worlds.world import World

FORMATS = ("obj", "stl", "ply", "glb", "dae")


def rover_in(world: World) -> VectorSimulation:
    """A rover at the start of an episode in a world."""
    simulation = simulation_on(world, 1, seed=3)
    simulation.reset()
    return simulation
