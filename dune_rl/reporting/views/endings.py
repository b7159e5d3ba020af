"""Describes how agents' episodes ended, for labels."""

import numpy as np

from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.state.state import GroupState

_ENDINGS = {
    "goal_reached": "goal reached",
    "stuck": "stuck",
    "flipped": "turned over",
    "out_of_world": "left the world",
    "time_limit": "out of time",
}
# Label of an agent that was not done when its scene's episode ended.
_CUT_SHORT = "cut short"


def describe_ending(group: GroupState, row: int) -> str:
    """How the episode of an agent ended in the step that `group` describes."""
    if group.motion.diverged[row]:
        return "physics diverged"
    names = [name for name, flags in group.endings.items() if flags[row]]
    # If several apply, the first of `_ENDINGS` is shown.
    known = [name for name in _ENDINGS if name in names]
    name = next(iter([*known, *names]), None)
    if name is None:
        return _CUT_SHORT
    if name == "goal_reached" and group.contacts.total[row]:
        return "goal reached, after a collision"
    return _ENDINGS.get(name, name.replace("_", " "))


class EndingRecorder:
    """Records how each agent's episode ended: call `reset` at its start and `update` after every step."""

    def __init__(self, simulation: VectorSimulation) -> None:
        self._simulation = simulation
        self._endings: dict[str, list[str | None]] = {
            group.name: [None] * (simulation.num_scenes * group.count) for group in simulation.groups
        }

    def reset(self, scene: int) -> None:
        """Clear the endings of a scene's agents."""
        for group in self._simulation.groups:
            for row in range(scene * group.count, (scene + 1) * group.count):
                self._endings[group.name][row] = None

    def update(self) -> None:
        """Record the agents that are done for the first time after this step."""
        for group in self._simulation.groups:
            endings = self._endings[group.name]
            done = group.done if group.absent is None else group.done & ~group.absent
            for row in np.flatnonzero(done).tolist():
                if endings[row] is None:
                    endings[row] = describe_ending(self._simulation.state.groups[group.name], row)

    def ending(self, group: str, row: int) -> str | None:
        """How the episode of an agent ended; None while it goes on."""
        return self._endings[group][row]


def finite_points(points: list[Array]) -> Array:
    """The points (P, 2) of a track that are finite: where physics diverged, a track ends early."""
    track = np.array(points)
    return track[np.isfinite(track).all(axis=1)]
