"""Simulations of several robots, and how they stand to each other."""

from typing import Any

import numpy as np
from simulations import (
    act,
    bearing,
    motion_of_group,
    started_simulation,
    state_of_group,
)

from dune_rl.env.simulation import VectorSimulation

KINDS = ["rover_zero", "leo_rover"]
TWINS = ["rover_zero", "rover_zero"]
CLOSE = {"spawn": {"region": [-2.0, 2.0, -2.0, 2.0]}}
NO_ARRIVAL = {"terminations": {"goal_reached": {"distance_m": 0.01}}}


def simulation_of(
    robots: list[Any], world: str = "flat", num_scenes: int = 1, **settings: Any
) -> VectorSimulation:
    return started_simulation(world, num_scenes, robots=robots, **settings)


def positions(simulation: VectorSimulation) -> np.ndarray:
    """Of the origins of all robots of each scene, seen from above, (M, R, 2)."""
    states = [
        state_of_group(simulation, group.name) for group in simulation.groups if group.description.is_robot
    ]
    return np.concatenate([now.by_scene(now.motion.position_w[:, :2]) for now in states], axis=1)


def distance(simulation: VectorSimulation) -> np.ndarray:
    """Between the origins of the first and the second robot of each scene, seen from above, (M,)."""
    found = positions(simulation)
    return np.hypot(*(found[:, 0] - found[:, 1]).T)


def bearings_of_each_other(simulation: VectorSimulation) -> dict[str, np.ndarray]:
    """By group, the bearing of the other one of two robots in each scene, (N,)."""
    found = positions(simulation)
    others, first = {}, 0
    for group in simulation.external:
        partner = [1 - number for number in range(first, first + group.count)]
        points = found[:, partner].reshape(-1, 2)
        others[group.name] = bearing(motion_of_group(simulation, group.name), points)
        first += group.count
    return others


def drive_at_each_other(simulation: VectorSimulation, speed_mps: float = 0.5) -> None:
    """A control step in which two robots of a scene turn to each other and then drive at each other."""
    actions = {
        name: np.stack([np.where(np.abs(turn) < 0.3, speed_mps, 0.0), turn], axis=1)
        for name, turn in bearings_of_each_other(simulation).items()
    }
    act(simulation, **actions)
