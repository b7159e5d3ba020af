"""The recent training episodes of a group, over which its statistics are taken."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from dune_rl.statistics.measures import MetricsRow, average_metrics

_WINDOW = 100


class RecentEpisodes:
    """The last hundred training episodes of a group's agents, with metrics of these `names`."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: deque[list[float]] = deque(maxlen=_WINDOW)
        self._uncounted = 0

    def __len__(self) -> int:
        return len(self._rows)

    def extend(self, rows: Sequence[list[float]]) -> bool:
        """Add rows of metrics; returns whether a hundred have come in since it last did."""
        self._rows.extend(rows)
        self._uncounted += len(rows)
        full = self._uncounted >= _WINDOW
        if full:
            self._uncounted = 0
        return full

    def clear(self) -> None:
        """Forget the episodes: another policy drives from now on."""
        self._rows.clear()
        self._uncounted = 0

    def average_metrics(self) -> MetricsRow:
        """Means over the recent episodes."""
        return average_metrics([dict(zip(self.names, row, strict=True)) for row in self._rows])

    def columns(self) -> dict[str, list[float]]:
        """The values of each metric over the recent episodes."""
        return (
            dict(zip(self.names, map(list, zip(*self._rows, strict=True)), strict=True)) if self._rows else {}
        )

    @property
    def success_rate(self) -> float:
        """Share of successes; NaN before the first episode, and where success is no metric."""
        if not self._rows or "success" not in self.names:
            return math.nan
        column = self.names.index("success")
        return sum(row[column] for row in self._rows) / len(self._rows)

    def state(self) -> dict[str, Any]:
        """Plain data for `restore`."""
        window = torch.tensor(list(self._rows), dtype=torch.float64).reshape(-1, len(self.names))
        return {"names": list(self.names), "window": window, "unrecorded": self._uncounted}

    def restore(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state`; rows of other metrics (of an older version) are dropped."""
        self._uncounted = state["unrecorded"]
        if tuple(state["names"]) == self.names:
            self._rows.extend(state["window"].tolist())
