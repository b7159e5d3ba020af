"""Progress reports of a training run: a progress bar, plain lines, or none."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

# Width of the terminal [columns] from which the bar also shows counts of frames.
_WIDE = 120


@dataclass(frozen=True)
class TrainingStatus:
    """Progress of a run: counts, recent speeds [1/s], and the success rate over recent training episodes."""

    frames: int
    total_frames: int
    frames_per_s: float
    updates_per_s: float
    success_rate: float
    activity: str = "training"

    @property
    def seconds_left(self) -> float:
        """Time to the end at the recent speed [s]; NaN while that is unknown."""
        # The last batch may go beyond the total.
        left = max(0, self.total_frames - self.frames)
        return left / self.frames_per_s if self.frames_per_s > 0 else math.nan

    def counts(self) -> str:
        """The current activity and the number of frames."""
        return f"{self.activity}  {self.frames:,} of {self.total_frames:,} frames"

    def statistics(self) -> str:
        """Speeds, success rate and time left, in one line."""
        rate = "unknown" if math.isnan(self.success_rate) else f"{100 * self.success_rate:.0f} %"
        return (
            f"{self.frames_per_s:,.0f} frames/s  {self.updates_per_s:,.0f} updates/s  "
            f"success {rate}  {_clock(self.seconds_left)} left"
        )


def _clock(seconds: float) -> str:
    if math.isnan(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class Reporter(Protocol):
    """Context manager that shows the progress of a run; `update` is called inside the context."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def update(self, status: TrainingStatus) -> None:
        """Show `status`; called after every batch."""


class SilentReporter:
    """Reports nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def update(self, status: TrainingStatus) -> None:
        """Do nothing."""


class BarReporter:
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
        """Redraw the bar, as often as its console refreshes."""
        self._bar.update(
            self._task,
            completed=status.frames,
            total=status.total_frames,
            description=status.counts() if self._is_wide else status.activity,
            statistics=status.statistics(),
        )


class LineReporter:
    """Calls `emit` with one plain line every `interval_s` [s], for logs and pipes."""

    def __init__(self, emit: Callable[[str], None], interval_s: float = 15.0) -> None:
        self._emit = emit
        self._interval_s = interval_s
        self._last = -math.inf

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def update(self, status: TrainingStatus) -> None:
        """Emit a line unless the last one is more recent than `interval_s`."""
        now = time.monotonic()
        if now - self._last >= self._interval_s:
            self._last = now
            self._emit(f"{status.counts()}  {status.statistics()}")
