"""When a live view takes its next step: pause, single steps, and the speed of time."""

import time
from collections.abc import Callable

# Factors of real time, slowest first.
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_NAP_S = 0.005
# Steps that are later than this are not made up for.
_MOST_BEHIND_S = 0.2


class Playback:
    """The clock of a live view. Its page calls it from other threads than the simulation."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.is_paused = False
        self.speed = 1.0
        self._single_steps = 0
        self._next_s = 0.0

    def toggle_pause(self) -> None:
        """Pause, or go on."""
        self.is_paused = not self.is_paused

    def step_once(self) -> None:
        """Pause, and take one step."""
        self.is_paused = True
        self._single_steps += 1

    def slower(self) -> None:
        """Take the next slower speed."""
        self.speed = max((each for each in SPEEDS if each < self.speed), default=SPEEDS[0])

    def faster(self) -> None:
        """Take the next faster speed."""
        self.speed = min((each for each in SPEEDS if each > self.speed), default=SPEEDS[-1])

    def is_due(self, step_s: float) -> bool:
        """Whether to take a step of `step_s` [s] now; a True counts as taken."""
        if self._single_steps:
            self._single_steps -= 1
            return True
        now = self._clock()
        if self.is_paused or now < self._next_s:
            return False
        self._next_s = max(self._next_s, now - _MOST_BEHIND_S) + step_s / self.speed
        return True

    def wait(self, step_s: float) -> None:
        """Return when the next step is due."""
        while not self.is_due(step_s):
            time.sleep(_NAP_S)
