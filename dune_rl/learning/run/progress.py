"""Progress of a training run or an evaluation: speed, success and time left, in a bar or in plain lines."""

import math
import time
from collections import deque
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

from dune_rl.learning.evaluation import PeriodicEvaluation

# Speeds are means over this time [s]. Until the other has passed, as processes start, nothing is estimated.
_WINDOW_S, _SETTLED_S = 20.0, 35.0
_ESTIMATE_AFTER_S = 60.0
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


class RunStatus:
    """Measures a run's speed and reports its progress.

    While a warm-up policy drives, neither its success nor its speed counts as those of the training. After a
    minute, once the speed of training is known, the reporter is told how long the run will take.
    """

    def __init__(self, reporter: Reporter, evaluation: PeriodicEvaluation, total_frames: int) -> None:
        self._reporter, self._evaluation, self._total_frames = reporter, evaluation, total_frames
        self.speed = SpeedMeter()
        self._start = time.monotonic()
        self._has_estimated = False
        self._evaluation_start = 0.0

    def report_batch(
        self, frames: int, updates: int, *, warmup: str | None, success_rate: float
    ) -> dict[str, float]:
        """Report a batch that has been learned from; returns the speeds [1/s] by the names of their logs.

        `warmup` says what drives in place of the policies that are trained: "scripted" or "random".
        """
        frames_per_s, updates_per_s = self.speed.mark(frames, updates)
        if warmup is not None:
            self._show(frames, f"{warmup} warm-up")
        else:
            left = self._seconds_left(frames)
            self._show(frames, "training", success_rate, left)
            elapsed = time.monotonic() - self._start
            if not (math.isnan(left) or self._has_estimated) and elapsed >= _ESTIMATE_AFTER_S:
                self._has_estimated = True
                if left >= _ESTIMATE_AFTER_S:
                    self._reporter.note(describe_duration(elapsed, left))
        return {"speed/frames": frames_per_s, "speed/updates": updates_per_s}

    def begin_evaluation(self, frames: int) -> None:
        self._evaluation_start = time.monotonic()
        self.report_evaluation(frames, 0)

    def report_evaluation(self, frames: int, done: int) -> None:
        """Report the number of episodes of the evaluation that are done."""
        activity = f"evaluating {done}/{self._evaluation.episodes}"
        self._show(frames, activity, seconds_left=self._seconds_left(frames))

    def end_evaluation(self) -> None:
        """Leave the evaluation out of the speeds, and remember how long it took."""
        self.speed.pause(time.monotonic() - self._evaluation_start)

    def _seconds_left(self, frames: int) -> float:
        evaluations = self._evaluation.count_left(frames, self._total_frames)
        return self.speed.seconds_left(self._total_frames - frames, evaluations)

    def _show(
        self, frames: int, activity: str, success_rate: float = math.nan, seconds_left: float = math.nan
    ) -> None:
        rates = (*self.speed.latest, success_rate, self._evaluation.success_rate)
        self._reporter.update(TrainingStatus(frames, self._total_frames, *rates, seconds_left, activity))


def describe_duration(elapsed_s: float, left_s: float) -> str:
    """A sentence on how long a run takes in all, and when it ends."""
    minutes = (elapsed_s + left_s) / 60
    total = f"{minutes:.0f} minutes" if minutes < 120 else f"{minutes / 60:.1f} hours"
    end = time.strftime("%H:%M", time.localtime(time.time() + left_s))
    return f"At its speed on this machine the run takes about {total}, until {end}."


class SpeedMeter:
    """Frames and updates per second over the last seconds, and the time of an evaluation.

    `latest` are the speeds [1/s] at the last mark, zero before the second. They are known well enough for an
    estimate 35 s after the second mark, evaluations left out.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._marks: deque[tuple[float, int, int]] = deque()
        self.latest = (0.0, 0.0)
        self._evaluation_s = 0.0
        self._begun_s, self._is_known = math.nan, False

    def mark(self, frames: int, updates: int) -> tuple[float, float]:
        """Record the counts now; returns the speeds, and after a pause the speeds from before it."""
        now = self._clock()
        self._marks.append((now, frames, updates))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW_S:
            self._marks.popleft()
        start, frames_then, updates_then = self._marks[0]
        span = now - start
        if span > 0:
            self.latest = (frames - frames_then) / span, (updates - updates_then) / span
            self._is_known |= now - self._begun_s >= _SETTLED_S
        if math.isnan(self._begun_s) and len(self._marks) > 1:
            # Until the second mark processes may still start, and what a warm-up tells is learnt at once.
            self._begun_s = now
        return self.latest

    def pause(self, evaluation_s: float) -> None:
        """Leave an evaluation of `evaluation_s` [s], since the last mark, out of the speeds."""
        self._marks.clear()
        self._begun_s += evaluation_s
        self._evaluation_s = evaluation_s

    def restart(self) -> None:
        self._marks.clear()
        self.latest = (0.0, 0.0)
        self._begun_s, self._is_known = math.nan, False

    def seconds_left(self, frames: int, evaluations: int) -> float:
        """Time for so many frames and evaluations at the latest speeds [s]; NaN while they are unknown."""
        if self.latest[0] <= 0 or not self._is_known:
            return math.nan
        return max(0, frames) / self.latest[0] + evaluations * self._evaluation_s
