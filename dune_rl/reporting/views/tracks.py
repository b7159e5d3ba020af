"""Records the tracks of all agents, while they are there."""

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.reporting.views.endings import EndingRecorder, finite_points
from dune_rl.visualization.site_map.panel import Track


class TrackRecorder:
    """Positions of all agents from the start of their episodes."""

    def __init__(self, simulation: VectorSimulation) -> None:
        self._simulation = simulation
        self._endings = EndingRecorder(simulation)
        self._points: dict[tuple[str, int], list[Array]] = {}
        for scene in range(simulation.num_scenes):
            self.reset(scene)

    def reset(self, scene: int) -> None:
        """Begin new tracks in a scene, at the agents' present positions."""
        self._endings.reset(scene)
        for group in self._simulation.groups:
            places = _places(group)
            for row in range(scene * group.count, (scene + 1) * group.count):
                self._points[group.name, row] = [places[row]]

    def update(self) -> None:
        """Add the agents' positions after a step; call it before scenes are reset."""
        self._endings.update()
        for group in self._simulation.groups:
            for row, position in enumerate(_places(group)):
                self._points[group.name, row].append(position)

    def tracks(self, scene: int) -> list[Track]:
        """The tracks of a scene's agents."""
        episode = int(self._simulation.episodes[scene])
        return [
            Track(
                name,
                episode,
                finite_points(self._points[group.name, scene * group.count + agent]),
                self._endings.ending(group.name, scene * group.count + agent) if group.is_external else None,
            )
            for group in self._simulation.groups
            for agent, name in enumerate(group.names)
        ]


def _places(group: AgentGroup) -> Array:
    """Positions (N, 2) [m] of a group's agents; NaN for those that are not there."""
    places = group.body.motion.position_w[:, :2].copy()
    if group.absent is not None:
        places[group.absent] = np.nan
    return places
