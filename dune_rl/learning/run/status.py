"""What a run shows of itself: who drives, how fast, how well, and how long it will take."""

import math
import time

from dune_rl.learning.periodic_evaluation import PeriodicEvaluation
from dune_rl.learning.run.progress import Reporter, TrainingStatus
from dune_rl.learning.run.speed import DurationEstimate, SpeedMeter

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
