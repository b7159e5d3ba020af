"""The progress of a run: speed, success, and the time left."""

import math
import time
from collections import deque
from collections.abc import Callable

from dune_rl.learning.periodic_evaluation import PeriodicEvaluation
from dune_rl.learning.run.progress import Reporter, TrainingStatus

# Speeds are means over this time [s]; over less than the other, they are not told to a user.
_WINDOW_S, _LEAST_WINDOW_S = 20.0, 15.0
_ESTIMATE_AFTER_S = 60.0


class RunStatus:
    """Measures a run's speed and reports its progress.

    While a warm-up policy drives, neither its success nor its speed counts as those of the training. After a
    minute of training the reporter is told once how long the run will take.
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
            # Speeds over a moment, as where the warm-up has just ended, would mislead.
            is_known = self.speed.window_s >= _LEAST_WINDOW_S and not math.isnan(left)
            if is_known and not self._has_estimated and elapsed >= _ESTIMATE_AFTER_S:
                self._has_estimated = True
                if left >= _ESTIMATE_AFTER_S:
                    self._reporter.note(describe_duration(elapsed, left))
        return {"speed/frames": frames_per_s, "speed/updates": updates_per_s}

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
        self.speed.pause(time.monotonic() - self._evaluation_start)

    def _seconds_left(self, frames: int) -> float:
        evaluations = self._evaluation.count_left(frames, self._total_frames)
        return self.speed.seconds_left(self._total_frames - frames, evaluations)

    def _show(
        self, frames: int, activity: str, success_rate: float = math.nan, seconds_left: float = math.nan
    ) -> None:
        speeds, evaluated = self.speed.latest, self._evaluation.success_rate
        self._reporter.update(
            TrainingStatus(
                frames, self._total_frames, *speeds, success_rate, evaluated, seconds_left, activity
            )
        )


def describe_duration(elapsed_s: float, left_s: float) -> str:
    """A sentence on how long a run takes in all, and when it ends."""
    minutes = (elapsed_s + left_s) / 60
    total = f"{minutes:.0f} minutes" if minutes < 120 else f"{minutes / 60:.1f} hours"
    end = time.strftime("%H:%M", time.localtime(time.time() + left_s))
    return f"At its speed on this machine the run takes about {total}, until {end}."


class SpeedMeter:
    """Frames and updates per second over the last seconds, and the time of an evaluation.

    `latest` are the speeds [1/s] at the last mark, zero before the second.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._marks: deque[tuple[float, int, int]] = deque()
        self.latest = (0.0, 0.0)
        self._evaluation_s = 0.0

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
        return self.latest

    @property
    def window_s(self) -> float:
        """Time over which the latest speeds were measured [s]."""
        return self._marks[-1][0] - self._marks[0][0] if self._marks else 0.0

    def pause(self, evaluation_s: float) -> None:
        """Leave an evaluation of `evaluation_s` [s], since the last mark, out of the speeds."""
        self._marks.clear()
        self._evaluation_s = evaluation_s

    def restart(self) -> None:
        """Forget all speeds: another phase begins."""
        self._marks.clear()
        self.latest = (0.0, 0.0)

    def seconds_left(self, frames: int, evaluations: int) -> float:
        """Time for so many frames and evaluations at the latest speeds [s]; NaN while they are unknown."""
        if self.latest[0] <= 0:
            return math.nan
        return max(0, frames) / self.latest[0] + evaluations * self._evaluation_s
