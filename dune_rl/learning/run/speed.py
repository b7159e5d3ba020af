"""How fast a run collects, learns and evaluates, and how long it will take."""

import math
import time
from collections import deque
from collections.abc import Callable

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
