"""What is measured of the episodes of an agent group: its own metrics, and sets that transforms add."""

from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.metrics.episode import MetricsConf, MetricSet
from dune_rl.state.state import GroupState, State


class GroupMetrics:
    """The metric sets of a group of N agents: `own` is that of its settings, if they name one.

    All sets see the same states at the same instants: before goals are renewed, and before the agents whose
    episodes end with the step count as done.
    """

    def __init__(self, conf: MetricsConf | None, num_rows: int) -> None:
        self._num_rows = num_rows
        self.own = None if conf is None else MetricSet(conf, num_rows)
        self._added: dict[str, MetricSet] = {}

    @property
    def needs_joints(self) -> bool:
        """Whether a set reads the joints' state."""
        return any(each.needs_joints for each in self._sets())

    @property
    def needs_scan(self) -> bool:
        """Whether a set reads `GroupState.nearest_return`."""
        return any(each.needs_scan for each in self._sets())

    @property
    def added(self) -> list[dict[str, Any]]:
        """The settings of the added sets as plain data."""
        return [MetricsConf.model_validate_json(key).model_dump(mode="json") for key in self._added]

    def add(self, conf: MetricsConf, now: GroupState | None) -> MetricSet:
        """The set of `conf`, which is made at its first call; equal settings share one.

        It begins at `now`, the present state, or with the next episodes where there is none yet.
        """
        key = conf.model_dump_json()
        if key not in self._added:
            self._added[key] = made = MetricSet(conf, self._num_rows)
            if now is not None:
                made.reset(np.ones(self._num_rows, bool), now)
        return self._added[key]

    def reset(self, mask: Flags, now: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        for each in self._sets():
            each.reset(mask, now)

    def clear(self, mask: Flags) -> None:
        """Leave the agents in `mask` (N,) without values, as they have no episode."""
        if mask.any():
            for each in self._sets():
                each.clear(mask)

    def update(self, state: State, now: GroupState, reward: Array) -> None:
        """Add one control step with its `reward` (N,)."""
        for each in self._sets():
            each.update(state, now, reward)

    def _sets(self) -> list[MetricSet]:
        return [*([] if self.own is None else [self.own]), *self._added.values()]
