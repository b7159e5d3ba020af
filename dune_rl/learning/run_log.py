"""What a run writes down: TensorBoard events, the window of recent episodes, and metrics.csv."""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from dune_rl.learning.curve import draw_curve
from dune_rl.learning.evaluation import Row, averages, write_csv

METRICS_FILE = "metrics.csv"
CURVE_FILE = "curve.png"
_WINDOW = 100
_SPEED_WINDOW_S = 20.0


class Speed:
    """Frames and updates per second over the last seconds."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, int, int]] = deque()
        self._latest = (0.0, 0.0)

    def mark(self, frames: int, updates: int) -> tuple[float, float]:
        """Take note of the counts now; gives frames/s and updates/s, zero before the second mark.

        The first mark after a pause gives the speeds from before it.
        """
        now = time.monotonic()
        self._marks.append((now, frames, updates))
        while len(self._marks) > 2 and now - self._marks[0][0] > _SPEED_WINDOW_S:
            self._marks.popleft()
        start, frames_then, updates_then = self._marks[0]
        span = now - start
        if span > 0:
            self._latest = (frames - frames_then) / span, (updates - updates_then) / span
        return self._latest

    def pause(self) -> None:
        """Leave what happened since the last mark out of the speeds: an evaluation, say."""
        self._marks.clear()


class RunLog:
    """Logs into `folder`; `state` and `restore` carry what a resumed run needs."""

    def __init__(self, folder: Path, metric_names: Sequence[str], *, frames: int = 0) -> None:
        self._folder = folder
        self._names = tuple(metric_names)
        self._window: deque[list[float]] = deque(maxlen=_WINDOW)
        self._unrecorded = 0
        self.history: list[dict[str, Any]] = []
        # A resumed run repeats the steps after its checkpoint; their first version is dropped.
        self._events = SummaryWriter(str(folder), purge_step=frames or None)

    def collected(self, batch: TensorDictBase, frames: int, updates: int) -> None:
        """Log the episodes that ended in `batch`; every hundred of them make a line of metrics.csv."""
        finished = batch["next", "done"].squeeze(-1)
        if not finished.any():
            return
        rows: Tensor = batch["next", "metrics"][finished]
        self._window.extend(rows.tolist())
        for name, value in zip(self._names, rows.nanmean(0).tolist(), strict=True):
            if name.startswith(("reward/", "randomisation/")):
                self._events.add_scalar(name, value, frames)
        recent = self._recent()
        figures = averages(recent)
        self._scalars("train", figures, frames)
        self._unrecorded += len(rows)
        if self._unrecorded >= _WINDOW:
            self._unrecorded = 0
            self._record("train", len(recent), figures, frames, updates)

    def _recent(self) -> list[Row]:
        return [dict(zip(self._names, row, strict=True)) for row in self._window]

    @property
    def success_rate(self) -> float:
        """Over the recent training episodes; NaN before the first ends."""
        column = self._names.index("success")
        return sum(row[column] for row in self._window) / len(self._window) if self._window else math.nan

    def learned(self, values: Mapping[str, float], frames: int) -> None:
        """Log losses and the like."""
        for name, value in values.items():
            self._events.add_scalar(name, value, frames)

    def evaluated(self, rows: Sequence[Row], frames: int, updates: int) -> None:
        """Add an evaluation to TensorBoard and metrics.csv, and write both to disk."""
        figures = averages(rows)
        self._scalars("eval", figures, frames)
        self._record("eval", len(rows), figures, frames, updates)
        self.write()

    def write(self) -> None:
        """Bring metrics.csv and the TensorBoard file up to date."""
        self._events.flush()
        if self.history:
            write_csv(self._folder / METRICS_FILE, self.history)

    def _record(self, kind: str, episodes: int, figures: Row, frames: int, updates: int) -> None:
        self.history.append(
            {"kind": kind, "frames": frames, "updates": updates, "episodes": episodes, **figures}
        )

    def draw(self, title: str) -> None:
        """Write the learning curve, if there is a point to draw."""
        if self.history:
            draw_curve(self.history, self._folder / CURVE_FILE, title)

    def _scalars(self, group: str, figures: Row, frames: int) -> None:
        for name, value in figures.items():
            if not math.isnan(value):
                self._events.add_scalar(f"{group}/{name}", value, frames)

    def state(self) -> dict[str, Any]:
        """Plain data for `restore`."""
        window = torch.tensor(list(self._window), dtype=torch.float64).reshape(-1, len(self._names))
        return {
            "names": list(self._names),
            "window": window,
            "unrecorded": self._unrecorded,
            "history": self.history,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state`; a window of other metrics (of an older version) is dropped."""
        self.history = list(state["history"])
        self._unrecorded = state["unrecorded"]
        if tuple(state["names"]) == self._names:
            self._window.extend(state["window"].tolist())

    def close(self) -> None:
        """Write out what is pending."""
        self._events.close()
