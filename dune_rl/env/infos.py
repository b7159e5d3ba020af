"""The metrics of episodes as the `info` of PettingZoo and Gymnasium."""

from typing import Any

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Flags, Floats

# Gymnasium's wrappers write statistics to "episode", and read these; a metric of such a name gets another.
_RENAMED = {"episode": "episode_id"}


class EpisodeInfos:
    """The metrics of a group's agents in their episodes so far.

    A value that is not defined yet is -1: wrappers compare infos and rely on constant keys, so that NaN and
    missing keys would break them.
    """

    def __init__(self, simulation: VectorSimulation, group: AgentGroup) -> None:
        self._simulation, self._group = simulation, group
        names = simulation.metric_names(group.name) if group.metric_names else ()
        self._names = tuple(_RENAMED.get(name, name) for name in names)

    def each(self) -> list[dict[str, float]]:
        """The infos of the agents of scene 0."""
        if not self._names:
            return [{} for _ in range(self._group.count)]
        values = self._values()[0].tolist()
        exact = {"episode_id": float(self._simulation.episodes[0])}
        return [{**dict(zip(self._names, row, strict=True)), **exact} for row in values]

    def batched(self, mask: Flags | None = None) -> dict[str, Any]:
        """Arrays (M,) by name for a group of one agent, and under "_" + name which are valid: `mask`."""
        if not self._names:
            return {}
        values = np.ascontiguousarray(self._values()[:, 0].T, np.float64)
        valid = np.ones(values.shape[1], bool) if mask is None else mask
        infos: dict[str, Any] = dict(zip(self._names, values, strict=True))
        # Metrics are float32, in which large numbers are rounded.
        infos["episode_id"] = self._simulation.episodes.astype(np.float64)
        infos.update((f"_{name}", valid.copy()) for name in self._names)
        return infos

    def _values(self) -> Floats:
        return np.nan_to_num(self._simulation.metrics(self._group.name), nan=-1.0)
