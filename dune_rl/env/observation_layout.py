"""How clients get a group's observations: as dicts of boxes, or as one vector."""

from typing import Any

import gymnasium
import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.geometry.arrays import Floats
from dune_rl.sensors.sensor import Bounds, Reading

Observation = dict[str, Reading] | Floats


class ObservationLayout:
    """Space and values of the observations of a group's agents.

    They are dicts of boxes by the sensors' names or, if `flatten`, one float32 vector: the readings in the
    order of their names, each row after row, as `gymnasium.spaces.flatten` has them.
    """

    def __init__(self, group: AgentGroup, flatten: bool) -> None:
        self._group, self._flatten = group, flatten
        bounds = group.observation_bounds
        self.space: gymnasium.spaces.Dict | gymnasium.spaces.Box
        if flatten:
            low, high = (
                np.concatenate([np.ravel(bounds[key][side]).astype(np.float32) for key in sorted(bounds)])
                for side in (0, 1)
            )
            self.space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        else:
            self.space = gymnasium.spaces.Dict({key: box(each) for key, each in bounds.items()})

    def batch(self) -> Any:
        """The present observations of all N agents of the group: arrays (N, ...), or one (N, D)."""
        readings = self._group.observe()
        if not self._flatten:
            return readings
        rows = [readings[key].reshape(len(readings[key]), -1) for key in sorted(readings)]
        return np.concatenate(rows, axis=1, dtype=np.float32, casting="unsafe")

    def each(self) -> list[Observation]:
        """The present observation of each agent."""
        batch = self.batch()
        if self._flatten:
            return list(batch)
        rows = range(self._group.count)
        return [{key: value[row] for key, value in batch.items()} for row in rows]


def box(bounds: Bounds) -> gymnasium.spaces.Box:
    """The space between two bounds, of their type."""
    return gymnasium.spaces.Box(bounds[0], bounds[1], dtype=bounds[0].dtype.type)
