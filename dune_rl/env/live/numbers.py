"""The state of an agent in numbers, for people."""

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation


def describe_agent(
    simulation: VectorSimulation, group: AgentGroup, row: int, time_s: float
) -> list[tuple[str, str]]:
    """Names and values of what an agent does `time_s` into the episode; the first is the time."""
    state = simulation.state.groups[group.name]
    rows = [
        ("time", f"{time_s:.2f} s"),
        ("speed", f"{state.motion.velocity_b[row, 0].round(2) + 0.0:.2f} m/s"),
    ]
    if group.task is not None:
        rows.append(("goal", f"{state.goal.distance[row]:.2f} m"))
    return [
        *rows,
        ("slope", f"{np.rad2deg(state.motion.tilt[row]):.0f}°"),
        ("collisions", f"{state.contacts.total[row]:.0f}"),
    ]
