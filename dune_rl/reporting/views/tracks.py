"""Records the tracks of all agents, while they are there, and how their episodes ended."""

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.state.state import GroupState
from dune_rl.visualization.site_map.panel import Track

_ENDINGS = {
    "contact": "collision",
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
    name = next((name for name in (*_ENDINGS, *names) if name in names), None)
    if name is None:
        return _CUT_SHORT
    if name == "goal_reached" and group.contacts.total[row]:
        return "goal reached, after a collision"
    return _ENDINGS.get(name, name.replace("_", " "))


def finite_points(points: list[Array]) -> Array:
    """The points (P, 2) of a track that are finite: where physics diverged, a track ends early."""
    track = np.array(points)
    return track[np.isfinite(track).all(axis=1)]


class TrackRecorder:
    """Positions of all agents from the start of their episodes, and how each episode ended."""

    def __init__(self, simulation: VectorSimulation) -> None:
        self._simulation = simulation
        self._endings: dict[tuple[str, int], str] = {}
        self._points: dict[tuple[str, int], list[Array]] = {}
        for scene in range(simulation.num_scenes):
            self.reset(scene)

    def reset(self, scene: int) -> None:
        """Begin new tracks in a scene, at the agents' present positions."""
        for group in self._simulation.groups:
            places = _places(group)
            for row in range(scene * group.count, (scene + 1) * group.count):
                self._endings.pop((group.name, row), None)
                self._points[group.name, row] = [places[row]]

    def update(self) -> None:
        """Add the agents' positions after a step, and new endings; call it before scenes are reset."""
        for group in self._simulation.groups:
            done = group.done if group.absent is None else group.done & ~group.absent
            for row in np.flatnonzero(done).tolist():
                if (group.name, row) not in self._endings:
                    state = self._simulation.state.groups[group.name]
                    self._endings[group.name, row] = describe_ending(state, row)
            for row, position in enumerate(_places(group)):
                self._points[group.name, row].append(position)

    def ending(self, group: str, row: int) -> str | None:
        """How the episode of an agent ended; None while it goes on."""
        return self._endings.get((group, row))

    def tracks(self, scene: int) -> list[Track]:
        """The tracks of a scene's agents."""
        episode = int(self._simulation.episodes[scene])
        return [
            Track(
                name,
                episode,
                finite_points(self._points[group.name, row]),
                self.ending(group.name, row) if group.is_external else None,
            )
            for group in self._simulation.groups
            for row, name in enumerate(group.names, scene * group.count)
        ]


def _places(group: AgentGroup) -> Array:
    """Positions (N, 2) [m] of a group's agents; NaN for those that are not there."""
    places = group.body.motion.position_w[:, :2].copy()
    if group.absent is not None:
        places[group.absent] = np.nan
    return places
