"""Families of randomised scenes, and drives in them whose commands depend on the episode and step alone."""

from typing import Any

import numpy as np
from simulations import act, metrics, new_simulation, observation, state_of_group
from walker_groups import walker_groups

from dune_rl.env.simulation import VectorSimulation

SMALL: dict[str, Any] = {
    "camera": {"width": 12, "height": 8, "outputs": ["rgb", "depth", "segmentation", "normals"]},
    "lidar_3d": {"n_rings": 3, "n_beams": 24, "outputs": ["range", "intensity", "segmentation"]},
}
EVERY_SENSE = {
    "enabled": [
        *("camera", "lidar", "lidar_past", "lidar_3d", "depth_strip", "height_scan", "imu", "goal"),
        *("velocity", "encoders", "odometry", "currents", "position"),
    ],
    **SMALL,
}
# Few worlds, so that scenes share some; two lights, so that they do not look alike for all that.
ISLANDS: dict[str, Any] = {
    "world": {"name": "island", "grass_cover": 0.3},
    "sensors": EVERY_SENSE,
    "actors": walker_groups(
        [{"length_range_m": [3.0, 10.0]}, {"controller": "external", "length_range_m": [3.0, 10.0]}]
    ),
    "weather": {"fog_visibility_m": 20.0},
    "randomisation": {
        "world_seed": [1, 2, 3],
        "friction": [0.4, 1.2],
        "sun_bearing_deg": {"name": "choice", "values": [0.0, 115.0]},
    },
}
YARDS: dict[str, Any] = {
    "world": "inspection",
    "actors": "none",
    "randomisation": {"world_seed": [0, 1], "layout_seed": [0, 99], "friction": [0.4, 1.2]},
}
# Another light in one world: scenes are apart for cameras alone.
EVENINGS: dict[str, Any] = {
    "world": "island",
    "sensors": {"enabled": ["camera", "lidar_3d", "goal"], **SMALL},
    "randomisation": {"sun_elevation_deg": [6.0, 57.0], "brightness": [0.5, 1.5]},
}
# Another body in one world.
BODIES: dict[str, Any] = {
    "world": "inspection",
    "actors": "none",
    "sensors": {"enabled": ["lidar", "imu", "goal", "velocity", "encoders"]},
    "randomisation": {
        "mass": [0.7, 1.5],
        "centre_x_m": [-0.05, 0.05],
        "centre_z_m": [0.0, 0.1],
        "motor_strength": [0.5, 1.0],
        "wheel_friction": [0.5, 1.0],
        "action_latency_s": [0.0, 0.2],
    },
}
# All of that, on the other engine.
DARTS: dict[str, Any] = {
    **ISLANDS,
    "physics": "dart",
    "robot": "leo_rover",
    "sensors": {"enabled": ["lidar", "lidar_past", "imu", "goal", "velocity", "encoders", "currents"]},
    "randomisation": {
        **ISLANDS["randomisation"],
        **BODIES["randomisation"],
    },
}
FAMILIES = {"islands": ISLANDS, "yards": YARDS, "evenings": EVENINGS, "darts": DARTS}


def make(scenes: int, seed: int = 5, **settings: Any) -> VectorSimulation:
    """A simulation of a family, which is not reset."""
    return new_simulation(**({"actors": "walkers"} | settings), num_scenes=scenes, seed=seed)


def drive(
    simulation: VectorSimulation, episodes: list[int], first: int, steps: int
) -> list[dict[str, np.ndarray]]:
    """What is observed, earned and measured in each step, each (M, ...).

    Commands depend on an episode's id and step alone.
    """
    scenes = simulation.num_scenes
    seen = []
    for step in range(first, first + steps):
        draws = [np.random.default_rng((episode, step)) for episode in episodes]
        actions = {}
        for group in simulation.external:
            low = [-1.0, -1.0] if group.name.startswith("walker") else [0.2, -1.0]
            size = (group.count, 2)
            actions[group.name] = np.array([rng.uniform(low, [1.0, 1.0], size) for rng in draws])
        taken = act(simulation, **actions)
        found = {"ends": taken.done}
        for group in simulation.external:
            parts = {
                **observation(simulation, group.name),
                "reward": taken.groups[group.name].reward,
                "metrics": metrics(simulation, group.name),
                "clearance": state_of_group(simulation, group.name).clearance,
            }
            for name, values in parts.items():
                found[f"{group.name} {name}"] = values.reshape(scenes, group.count, *values.shape[1:])
        seen.append(found)
    return seen


def equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two arrays have equal values, NaN where the other has it."""
    return np.array_equal(one, other, equal_nan=True)
