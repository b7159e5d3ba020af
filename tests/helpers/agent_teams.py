"""Scenes of agent groups: teams, walkers that are agents, and groups configured one by one."""

from typing import Any

from simulations import started_simulation
from walker_groups import walker_groups

from dune_rl.env.simulation import VectorSimulation

SHORT = {"terminations": {"time_limit": {"max_steps": 15}}}
TWO_STEPS = {"terminations": {"time_limit": {"max_steps": 2}}}
TWO_WALKERS = [{"controller": "external"}, {"controller": "external"}]
SCRIPTED = {"speed_mps": 0.7}
SCENES: dict[str, dict[str, Any]] = {
    "team": {"robots": ["rover_zero"] * 3, "actors": "none"},
    "kinds": {
        "robots": ["rover_zero", "rover_zero", "hyperdog"],
        "actors": walker_groups([*TWO_WALKERS, SCRIPTED]),
    },
    "crowd": {"robots": ["rover_zero"], "actors": walker_groups([{"controller": "external"}] * 20)},
}
WORLDS = {"team": "flat", "kinds": "inspection", "crowd": "flat"}
# Groups as they are configured one by one: equal robots apart by their sensors, and a behaviour beside them.
EXPLICIT: dict[str, Any] = {
    "scout": {
        "body": "rover_zero",
        "count": 2,
        "sensors": ["lidar", "goal"],
        "task": {"name": "point_goal", **SHORT},
    },
    "carrier": {
        "body": "rover_zero",
        "sensors": ["goal", "velocity"],
        "task": {"name": "point_goal", **SHORT},
    },
    "guide": {"body": "leo_rover", "controller": "go_to_goal"},
    "child": {"body": {"name": "person", "height_m": 1.1, "radius_m": 0.2}, "count": 2, "controller": "path"},
}


def simulation(scene: str, num_scenes: int = 1, **settings: Any) -> VectorSimulation:
    return started_simulation(WORLDS[scene], num_scenes, **{**SCENES[scene], **settings})
