"""The progress of a run: speed, success, and the time left."""

import math
import time
from collections import deque
from collections.abc import Callable

from dune_rl.learning.periodic_evaluation import PeriodicEvaluation
from dune_rl.learning.run.progress import Reporter, TrainingStatus

_LEAST_WINDOW_S = 15.0


class RunStatus:
    """Measures a run's speed and reports its progress.

    While a warm-up policy drives, neither its success nor its speed is taken for that of the training.
    """

    def __init__(self, reporter: Reporter, evaluation: PeriodicEvaluation, total_frames: int) -> None:
        self._reporter, self._evaluation, self._total_frames = reporter, evaluation, total_frames
        self._speed = SpeedMeter()
        self._estimate = DurationEstimate()
        self._evaluation_start = 0.0

    def report_batch(
        self, frames: int, updates: int, *, warmup: str | None, success_rate: float
    ) -> dict[str, float]:
        """Report a batch that has been learned from; returns the speeds [1/s] by the names of their logs.

        `warmup` says who drives in the place of the policies that are trained, "scripted" or "random".
        """
        frames_per_s, updates_per_s = self._speed.mark(frames, updates)
        if warmup is not None:
            self._show(frames, f"{warmup} warm-up")
        else:
            left = self._seconds_left(frames)
            self._show(frames, "training", success_rate, left)
            # Speeds over a moment, as where the warm-up has just ended, would mislead.
            line = self._estimate.line(left) if self._speed.window_s >= _LEAST_WINDOW_S else None
            if line is not None:
                self._reporter.note(line)
        return {"speed/frames": frames_per_s, "speed/updates": updates_per_s}

    def restart_speed(self) -> None:
        """Forget the speeds, where the warm-up ends."""
        self._speed.restart()

    def begin_evaluation(self, frames: int) -> None:
        """Report that an evaluation begins."""
        self._evaluation_start = time.monotonic()
        self.report_evaluation(frames, 0)

    def report_evaluation(self, frames: int, done: int) -> None:
        """Report the number of episodes of the evaluation that are done."""
        activity = f"evaluating {done}/{self._evaluation.episodes}"
        self._show(frames, activity, seconds_left=self._seconds_left(frames))

    def end_evaluation(self) -> None:
        """Leave the evaluation out of the speeds, and remember how long it took."""
        self._speed.pause(time.monotonic() - self._evaluation_start)

    def _seconds_left(self, frames: int) -> float:
        evaluations = self._evaluation.count_left(frames, self._total_frames)
        return self._speed.seconds_left(self._total_frames - frames, evaluations)

    def _show(
        self, frames: int, activity: str, success_rate: float = math.nan, seconds_left: float = math.nan
    ) -> None:
        self._reporter.update(
            TrainingStatus(
                frames,
                self._total_frames,
                *self._speed.latest,
                success_rate,
                self._evaluation.success_rate,
                seconds_left,
                activity,
            )
        )


_WINDOW_S = 20.0


class SpeedMeter:
    """Frames and updates per second over the last seconds, and the time of an evaluation."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._marks: deque[tuple[float, int, int]] = deque()
        self._latest = (0.0, 0.0)
        self._evaluation_s = 0.0

    def mark(self, frames: int, updates: int) -> tuple[float, float]:
        """Record the counts now; returns frames/s and updates/s, zero before the second mark.

        The first mark after a pause returns the speeds from before it.
        """
        now = self._clock()
        self._marks.append((now, frames, updates))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW_S:
            self._marks.popleft()
        start, frames_then, updates_then = self._marks[0]
        span = now - start
        if span > 0:
            self._latest = (frames - frames_then) / span, (updates - updates_then) / span
        return self._latest

    @property
    def window_s(self) -> float:
        """Time over which the latest speeds were measured [s]."""
        return self._marks[-1][0] - self._marks[0][0] if self._marks else 0.0

    @property
    def latest(self) -> tuple[float, float]:
        """Frames/s and updates/s at the last mark."""
        return self._latest

    def pause(self, evaluation_s: float | None = None) -> None:
        """Leave what happened since the last mark out of the speeds, such as an evaluation.

        `evaluation_s` [s] is how long that took, for `seconds_left`.
        """
        self._marks.clear()
        if evaluation_s is not None:
            self._evaluation_s = evaluation_s

    def restart(self) -> None:
        """Forget all speeds: another phase begins."""
        self._marks.clear()
        self._latest = (0.0, 0.0)

    def seconds_left(self, frames: int, evaluations: int) -> float:
        """Time for so many frames and evaluations at the latest speeds [s]; NaN while they are unknown."""
        if self._latest[0] <= 0:
            return math.nan
        return max(0, frames) / self._latest[0] + evaluations * self._evaluation_s


class DurationEstimate:
    """Says once, when a minute of a run is over, how long it will take on this machine."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, after_s: float = 60.0) -> None:
        self._clock, self._after_s = clock, after_s
        self._start = clock()
        self._said = False

    def line(self, seconds_left: float) -> str | None:
        """The sentence, if now is the time for it: `seconds_left` is known and more than a minute."""
        elapsed = self._clock() - self._start
        if self._said or math.isnan(seconds_left) or elapsed < self._after_s:
            return None
        self._said = True
        if seconds_left < 60:
            return None
        minutes = (elapsed + seconds_left) / 60
        total = f"{minutes:.0f} minutes" if minutes < 120 else f"{minutes / 60:.1f} hours"
        end = time.strftime("%H:%M", time.localtime(time.time() + seconds_left))
        return f"At its speed on this machine the run takes about {total}, until {end}."
