"""How fast a run collects and learns."""

import time
from collections import deque

_WINDOW_S = 20.0


class SpeedMeter:
    """Frames and updates per second over the last seconds."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, int, int]] = deque()
        self._latest = (0.0, 0.0)

    def mark(self, frames: int, updates: int) -> tuple[float, float]:
        """Record the counts now; returns frames/s and updates/s, zero before the second mark.

        The first mark after a pause returns the speeds from before it.
        """
        now = time.monotonic()
        self._marks.append((now, frames, updates))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW_S:
            self._marks.popleft()
        start, frames_then, updates_then = self._marks[0]
        span = now - start
        if span > 0:
            self._latest = (frames - frames_then) / span, (updates - updates_then) / span
        return self._latest

    def pause(self) -> None:
        """Leave what happened since the last mark out of the speeds, such as an evaluation."""
        self._marks.clear()
