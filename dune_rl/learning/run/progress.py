"""Progress reports of a training run or an evaluation: a progress bar, plain lines, or none."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

# Width of the terminal [columns] from which the bar also shows counts of frames, and the success in training.
_WIDE = 150


@dataclass(frozen=True)
class TrainingStatus:
    """Progress of a run: counts, recent speeds [1/s], success rates, and the time left [s].

    `success_rate` is of recent training episodes, and `evaluated` of the last evaluation. Unknown values are
    NaN. While a warm-up policy drives, `activity` says so and `success_rate` is unknown.
    """

    frames: int
    total_frames: int
    frames_per_s: float
    updates_per_s: float
    success_rate: float = math.nan
    evaluated: float = math.nan
    seconds_left: float = math.nan
    activity: str = "training"

    def counts(self) -> str:
        """The current activity and the number of frames."""
        return f"{self.activity}  {self.frames:,} of {self.total_frames:,} frames"

    def statistics(self, *, brief: bool = False) -> str:
        """Time left, speeds and success rates in one line; `brief` fits beside a bar on 80 columns."""
        words = [f"{format_duration(self.seconds_left)} left", _speed("frames", self.frames_per_s)]
        if not brief:
            words.append(_speed("updates", self.updates_per_s))
            words.append(_percentage("success in training", self.success_rate))
        words.append(_percentage("evaluated", self.evaluated))
        return "  ".join(filter(None, words))


def _speed(counted: str, per_s: float) -> str:
    return f"{per_s:,.0f} {counted}/s" if per_s > 0 else ""


def _percentage(name: str, rate: float) -> str:
    return "" if math.isnan(rate) else f"{name} {100 * rate:.0f} %"


def format_duration(seconds: float) -> str:
    """A time as m:ss or h:mm:ss; "?" if it is NaN."""
    if math.isnan(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class Reporter(AbstractContextManager[Any]):
    """Shows the progress of a run inside the context; this one shows nothing."""

    def __exit__(self, *_: object) -> None:
        return None

    def update(self, status: TrainingStatus) -> None:
        """Show `status`; called after every batch."""

    def note(self, line: str) -> None:
        """Show a line that is said once."""


class BarReporter(Reporter):
    """A progress bar on a terminal, with the counts of frames where that is wide enough."""

    def __init__(self, console: Console) -> None:
        self._is_wide = console.width >= _WIDE
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TextColumn("{task.fields[statistics]}"),
            console=console,
            expand=True,
        )
        self._task = self._bar.add_task("training", total=None, statistics="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, status: TrainingStatus) -> None:
        self._bar.update(
            self._task,
            completed=status.frames,
            total=status.total_frames,
            description=status.counts() if self._is_wide else status.activity,
            statistics=status.statistics(brief=not self._is_wide),
        )

    def note(self, line: str) -> None:
        self._bar.console.print(line, highlight=False, markup=False, soft_wrap=True)


class LineReporter(Reporter):
    """Calls `emit` with one plain line every `interval_s` [s], for logs and pipes."""

    def __init__(self, emit: Callable[[str], None], interval_s: float = 15.0) -> None:
        self._emit = emit
        self._interval_s = interval_s
        self._last = -math.inf

    def update(self, status: TrainingStatus) -> None:
        """Emit a line unless the last one is more recent than `interval_s`."""
        now = time.monotonic()
        if now - self._last >= self._interval_s:
            self._last = now
            self._emit(f"{status.counts()}  {status.statistics()}")

    def note(self, line: str) -> None:
        self._emit(line)


@contextmanager
def show_episodes(
    console: Console, name: str, total: int, interval_s: float = 15.0, counted: str = "episodes"
) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` episodes are done: yields a function to call with their number.

    `counted` names them where they are something else. It is a bar on a terminal, and a line every
    `interval_s` [s] elsewhere.
    """
    if console.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console, transient=True, expand=True) as bar:
            task = bar.add_task(escape(name), total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    start = last = time.monotonic()

    def show(done: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= interval_s and done:
            last = now
            left = format_duration((now - start) * (total - done) / done)
            print(f"{name}: {done} of {total} {counted}  {left} left", flush=True)

    yield show
