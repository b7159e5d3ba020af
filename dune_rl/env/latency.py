"""Latency of motor commands."""

import numpy as np

from dune_rl.geometry.arrays import Array

LONGEST_S = 1.0


class Latency:
    """A delay line for the commands of N robots, with one delay per robot, in whole control steps.

    Until the first command arrives, the motors get `rest` (J), the commands of a
    standing robot.
    """

    def __init__(self, num_rows: int, rest: list[float], control_hz: int) -> None:
        self._rest, self._hz = np.array(rest), control_hz
        self.delays = np.zeros(num_rows, np.int64)
        self._rows = np.arange(num_rows)
        self._line = np.tile(self._rest, (1, num_rows, 1))
        self._now = 0

    def set_delay(self, row: int, latency_s: float) -> None:
        """Delay a row's commands by the nearest whole number of control steps from its next `reset` on."""
        self.delays[row] = steps = round(latency_s * self._hz)
        if steps >= len(self._line):
            self._lengthen(steps + 1)

    def reset(self, row: int) -> None:
        """Fill a row's delay line with the rest commands."""
        self._line[:, row] = self._rest

    def _lengthen(self, length: int) -> None:
        # The oldest row first, the present one last, and new ones before them.
        old = np.roll(self._line, -self._now - 1, axis=0)
        more = np.tile(self._rest, (length - len(old), len(self._rows), 1))
        self._line, self._now = np.concatenate([more, old]), length - 1

    def delayed(self, commands: Array) -> Array:
        """Push `commands` (N, J) and return the delayed ones, (N, J), that reach the motors in this step."""
        self._now = (self._now + 1) % len(self._line)
        self._line[self._now] = commands
        arrived: Array = self._line[(self._now - self.delays) % len(self._line), self._rows]
        return arrived
