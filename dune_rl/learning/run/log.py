"""What a run records: TensorBoard events, the recent episodes of each group, and metrics.csv."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from dune_rl.learning.curve import draw_curve
from dune_rl.learning.measures import MetricsRow, average_metrics, write_csv

METRICS_FILE = "metrics.csv"
CURVE_FILE = "curve.png"
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


class RunLog:
    """Logs of a run in `folder`, by group; where there are several, names begin with the group's.

    `metric_names` are the metrics of each group. `state` and `restore` carry what a resumed run needs.
    """

    def __init__(self, folder: Path, metric_names: Mapping[str, Sequence[str]], *, frames: int = 0) -> None:
        self._folder = folder
        self._recent = {group: RecentEpisodes(names) for group, names in metric_names.items()}
        self._several = len(metric_names) > 1
        self.history: list[dict[str, Any]] = []
        # A resumed run repeats the steps after its checkpoint; their first version is dropped.
        self._events = SummaryWriter(str(folder), purge_step=frames or None)

    def log_batch(
        self, batch: TensorDictBase, frames: int, updates: Mapping[str, int], kind: str = "train"
    ) -> None:
        """Log the episodes that ended in `batch`; every hundred of a group make a line of metrics.csv.

        `kind` is "warmup" while another policy than the learners' drives.
        """
        finished = batch["next", "done"].squeeze(-1)
        if not finished.any():
            return
        for group, recent in self._recent.items():
            rows: Tensor = batch["next", group, "metrics"][finished].flatten(0, 1)
            complete = recent.extend(rows.tolist())
            for name, value in zip(recent.names, rows.nanmean(0).tolist(), strict=True):
                if name.startswith(("reward/", "randomisation/")):
                    self.scalars(group, {name: value}, frames)
            statistics = recent.average_metrics()
            self._log_statistics(group, kind, statistics, frames)
            if complete:
                self._record(group, kind, len(recent), statistics, frames, updates[group])

    @property
    def success_rate(self) -> float:
        """Over the recent training episodes, the mean of the groups that have one; NaN before the first."""
        rates = [recent.success_rate for recent in self._recent.values()]
        known = [rate for rate in rates if not math.isnan(rate)]
        return sum(known) / len(known) if known else math.nan

    def clear_recent(self) -> None:
        """Forget the recent episodes: another policy drives from now on."""
        for recent in self._recent.values():
            recent.clear()

    def scalars(self, group: str | None, values: Mapping[str, float], frames: int) -> None:
        """Log statistics of a group, or with None of the whole run, under their names."""
        prefix = f"{group}/" if group is not None and self._several else ""
        for name, value in values.items():
            self._events.add_scalar(prefix + name, value, frames)

    def log_evaluation(
        self, rows: Mapping[str, Sequence[MetricsRow]], frames: int, updates: Mapping[str, int]
    ) -> None:
        """Add an evaluation to TensorBoard and metrics.csv, and write both to disk."""
        for group, episodes in rows.items():
            statistics = average_metrics(episodes)
            self._log_statistics(group, "eval", statistics, frames)
            self._record(group, "eval", len(episodes), statistics, frames, updates[group])
        self.write()

    def write(self) -> None:
        """Bring metrics.csv and the TensorBoard file up to date."""
        self._events.flush()
        if self.history:
            columns = {name: "" for row in self.history for name in row}
            write_csv(self._folder / METRICS_FILE, [columns | row for row in self.history])

    def _record(
        self, group: str, kind: str, episodes: int, statistics: MetricsRow, frames: int, updates: int
    ) -> None:
        row = {"kind": kind, "frames": frames, "updates": updates, "episodes": episodes, **statistics}
        self.history.append({"group": group, **row} if self._several else row)

    def draw(self, title: str) -> None:
        """Write the learning curve, if there is a point to draw."""
        if self.history:
            draw_curve(self.history, self._folder / CURVE_FILE, title)

    def _log_statistics(self, group: str, kind: str, statistics: MetricsRow, frames: int) -> None:
        known = {f"{kind}/{name}": value for name, value in statistics.items() if not math.isnan(value)}
        self.scalars(group, known, frames)

    def state(self) -> dict[str, Any]:
        """Plain data for `restore`."""
        recent = {group: recent.state() for group, recent in self._recent.items()}
        return {"recent": recent, "history": self.history}

    def restore(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state`."""
        self.history = list(state["history"])
        for group, recent in state["recent"].items():
            if group in self._recent:
                self._recent[group].restore(recent)

    def close(self) -> None:
        """Write out what is pending."""
        self._events.close()
