"""Logs of a run: TensorBoard events, recent episodes of each group, metrics.csv and the learning curve."""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter
from tensordict import TensorDictBase
from torch import Tensor

from dune_rl.core.files import write_atomically, write_csv
from dune_rl.learning.group_policy import acted_by_past
from dune_rl.learning.run.tensorboard import EventFile, HParam, Picture
from dune_rl.metrics.catalogue import measures_of
from dune_rl.statistics.measures import MetricsRow, average_metrics, mean_of_known

METRICS_FILE = "metrics.csv"
CURVE_FILE = "curve.png"
# Training episodes over which statistics are taken.
_WINDOW = 100
_SAMPLED = ("reward/", "randomisation/")


class RunLog:
    """Logs of a run in `folder`, by group; where there are several, names begin with the group's.

    `metric_names` are the metrics of each group. `state` and `restore` carry what a resumed run needs;
    `resumed_at` are the frames that such a run begins with.
    """

    def __init__(
        self, folder: Path, metric_names: Mapping[str, Sequence[str]], *, resumed_at: int | None = None
    ) -> None:
        self._folder = folder
        self._recent = {group: RecentEpisodes(names) for group, names in metric_names.items()}
        self._distributed = {group: _distributed(names) for group, names in metric_names.items()}
        self._several = len(metric_names) > 1
        self._has_session = False
        self.history: list[dict[str, Any]] = []
        self._events = EventFile(folder, resumed_at=resumed_at)

    def log_batch(
        self, batch: TensorDictBase, frames: int, updates: Mapping[str, int], kind: str = "train"
    ) -> None:
        """Log the episodes that ended in `batch`; every hundred of a group make a line of metrics.csv.

        `kind` is "warmup" while another policy than the learners' drives. Episodes in which a past policy
        acted for a group are none of its own.
        """
        finished = batch["next", "done"].squeeze(-1)
        if not finished.any():
            return
        for group, recent in self._recent.items():
            past = acted_by_past(batch, group)
            own = finished if past is None else finished & ~past
            if not own.any():
                continue
            rows: Tensor = batch["next", group, "metrics"][own].flatten(0, 1)
            # Agents that never came have no values at all.
            rows = rows[~rows.isnan().all(dim=1)]
            if not len(rows):
                continue
            complete = recent.extend(rows.tolist())
            for name, value in zip(recent.names, rows.nanmean(0).tolist(), strict=True):
                if name.startswith(_SAMPLED):
                    self.scalars(group, {name: value}, frames)
            statistics = average_metrics(recent.rows())
            self._log_statistics(group, kind, statistics, frames)
            if complete:
                self._record(group, kind, len(recent), statistics, frames, updates[group])
                self._log_distributions(group, f"{kind} episodes", recent.rows(), frames)
                actions: Tensor = batch[group, "action"].flatten(0, -2)
                parts = enumerate(actions.T.numpy())
                self.histograms(group, {f"actions/{part}": values for part, values in parts}, frames)

    @property
    def success_rate(self) -> float:
        """Over the recent training episodes, the mean of the groups that have one; NaN before the first."""
        return mean_of_known(recent.success_rate for recent in self._recent.values())

    def clear_recent(self) -> None:
        """Forget the recent episodes: another policy drives from now on."""
        for recent in self._recent.values():
            recent.clear()

    def scalars(self, group: str | None, values: Mapping[str, float], frames: int) -> None:
        """Log statistics of a group, or with None of the whole run, under their names."""
        for name, value in self._named(group, values).items():
            self._events.add_scalar(name, value, frames)

    def histograms(self, group: str, values: Mapping[str, Iterable[float]], frames: int) -> None:
        """Log distributions of a group under their names."""
        self._events.histograms(self._named(group, values), frames)

    def _named(self, group: str | None, values: Mapping[str, Any]) -> dict[str, Any]:
        prefix = f"{group}/" if group is not None and self._several else ""
        return {prefix + name: value for name, value in values.items()}

    def _log_statistics(self, group: str, kind: str, statistics: MetricsRow, frames: int) -> None:
        known = {f"{kind}/{name}": value for name, value in statistics.items() if not math.isnan(value)}
        self.scalars(group, known, frames)

    def _log_distributions(self, group: str, kind: str, rows: Sequence[MetricsRow], frames: int) -> None:
        columns = {f"{kind}/{name}": [row[name] for row in rows] for name in self._distributed[group]}
        self.histograms(group, columns, frames)

    def log_evaluation(
        self, rows: Mapping[str, Sequence[MetricsRow]], frames: int, updates: Mapping[str, int]
    ) -> None:
        """Add an evaluation to TensorBoard and metrics.csv, and write both to disk."""
        for group, episodes in rows.items():
            statistics = average_metrics(episodes)
            self._log_statistics(group, "eval", statistics, frames)
            self._log_distributions(group, "eval episodes", episodes, frames)
            self._record(group, "eval", len(episodes), statistics, frames, updates[group])
        self.write()

    def picture(self, name: str, picture: Picture, frames: int) -> None:
        self._events.add_image(name, picture, frames, dataformats="HWC")

    def begin_session(self, settings: Mapping[str, HParam]) -> None:
        """Declare the run's hyperparameters and the names of its results, once in its life."""
        if self._has_session or not settings:
            return
        results = {group: self._results(group, [], "") for group in self._recent}
        names = [name for group, values in results.items() for name in self._named(group, values)]
        self._events.begin_session(settings, names)
        self._has_session = True

    def end_session(self, rows: Mapping[str, Sequence[MetricsRow]], objective: str, frames: int) -> None:
        """Log the results of a finished run, of its last evaluation's `rows`; `objective` is a metric."""
        results: dict[str, float] = {}
        for group, episodes in rows.items():
            results |= self._named(group, self._results(group, episodes, objective))
        self._events.end_session(results, frames)

    def _results(self, group: str, episodes: Sequence[MetricsRow], objective: str) -> dict[str, float]:
        """Final results by their names in TensorBoard: the same names for every run of a task."""
        names = [measure.name for measure in measures_of(self._recent[group].names)]
        found = average_metrics(episodes)
        values = {name: found.get(name, math.nan) for name in (*names, "return", "steps")}
        values["objective"] = mean_of_known(row.get(objective, math.nan) for row in episodes)
        return {f"final/{name}": value for name, value in values.items()}

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

    def state(self) -> dict[str, Any]:
        recent = {group: recent.state() for group, recent in self._recent.items()}
        return {"recent": recent, "history": self.history, "has_session": self._has_session}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.history = list(state["history"])
        self._has_session = state["has_session"]
        for group, recent in state["recent"].items():
            if group in self._recent:
                self._recent[group].restore(recent)

    def close(self) -> None:
        """Close the TensorBoard file, of which `write` has brought all to the disk."""
        # Where the disk is full, the run has ended with that error already.
        with suppress(OSError):
            self._events.close()


class RecentEpisodes:
    """The last hundred training episodes of a group's agents, with metrics of these `names`."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: deque[list[float]] = deque(maxlen=_WINDOW)
        self._uncounted = 0

    def __len__(self) -> int:
        return len(self._rows)

    def extend(self, rows: Sequence[list[float]]) -> bool:
        """Add rows of metrics; returns whether a hundred have come in since the last time it did."""
        self._rows.extend(rows)
        self._uncounted += len(rows)
        full = self._uncounted >= _WINDOW
        if full:
            self._uncounted = 0
        return full

    def clear(self) -> None:
        self._rows.clear()
        self._uncounted = 0

    def rows(self) -> list[MetricsRow]:
        return [dict(zip(self.names, row, strict=True)) for row in self._rows]

    @property
    def success_rate(self) -> float:
        """Share of successes; NaN before the first episode, and where success is no metric."""
        if not self._rows or "success" not in self.names:
            return math.nan
        column = self.names.index("success")
        return sum(row[column] for row in self._rows) / len(self._rows)

    def state(self) -> dict[str, Any]:
        window = torch.tensor(list(self._rows), dtype=torch.float64).reshape(-1, len(self.names))
        return {"names": list(self.names), "window": window, "unrecorded": self._uncounted}

    def restore(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state`; rows of other metrics, as of another task, are dropped."""
        self._uncounted = state["unrecorded"]
        if tuple(state["names"]) == self.names:
            self._rows.extend(state["window"].tolist())


def _distributed(names: Sequence[str]) -> list[str]:
    """The metrics whose distributions are logged: of measures that are no shares, return and steps."""
    measured = [measure.metric for measure in measures_of(list(names)) if not measure.is_share]
    return [name for name in ("return", "steps", *dict.fromkeys(measured)) if name in names]


_EVALUATION, _TRAINING = "#1f5fa8", "#d9822b"
_KINDS = (
    ("train", _TRAINING, {"lw": 1.2, "alpha": 0.9}, "training (last 100 episodes)"),
    ("eval", _EVALUATION, {"lw": 2.0, "marker": "o", "ms": 4}, "evaluation (unseen episodes)"),
)
_ROWS = (("SR", "success rate"), ("return", "return per episode"))
History = Sequence[Mapping[str, object]]


def draw_curve(history: History, path: Path, title: str) -> None:
    """Success rate and return over frames, from the rows of `metrics.csv`, as a PNG at `path`.

    There is a column for each group, and no success rate where none has one.
    It needs no display, and no state of pyplot's.
    """
    groups = list(dict.fromkeys(str(row.get("group", "")) for row in history))
    shown = [(key, label) for key, label in _ROWS if any(key in row for row in history)]
    size = (1 + 6 * len(groups), 3 * len(shown))
    figure = Figure(figsize=size, dpi=130, layout="constrained")
    grid = figure.subplots(len(shown), len(groups), sharex=True, squeeze=False)
    for column, group in zip(grid.T, groups, strict=True):
        rows = [row for row in history if str(row.get("group", "")) == group]
        for axes, (key, label) in zip(column, shown, strict=True):
            _draw(axes, rows, key, label)
        column[0].set_title(f"{title}: {group}" if group else title, loc="left", fontsize=11)
        column[0].legend(loc="best" if len(shown) == 1 else "lower right", frameon=False, fontsize=9)
        column[-1].set_xlabel("frames")
        column[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
        column[-1].set_xlim(left=0)
    FigureCanvasAgg(figure)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw(axes: Axes, rows: History, key: str, label: str) -> None:
    for kind, colour, style, name in _KINDS:
        points = [row for row in rows if row["kind"] == kind]
        frames = np.array([row["frames"] for row in points], float)
        values = np.array([row.get(key, np.nan) for row in points], float)
        axes.plot(frames, values, color=colour, label=name, **style)
    axes.set_ylabel(label)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if key == "SR":
        axes.set_ylim(-0.02, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
