"""When each agent of a group is in its scene, where agents come and go."""

import numpy as np

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.tasks.presence import PresenceConf

_FOREVER = np.iinfo(np.int64).max
# An agent that finds no room when it is due tries again after this time.
_RETRY_S = 0.2


class PresenceSchedule:
    """The visits of N = M * G agents, rows scene after scene: each comes once in an episode, at most.

    `absent` (N,) marks agents that are not in their scenes now, `came` (N,) those that are or were.
    """

    def __init__(self, conf: PresenceConf, group: str, num_scenes: int, count: int, step_s: float) -> None:
        self._conf, self._group, self._count, self._step_s = conf, group, count, step_s
        rows = num_scenes * count
        self.absent, self.came = np.zeros(rows, bool), np.ones(rows, bool)
        self._due, self._came_at = np.zeros((2, rows), np.int64)
        self._stay = np.full(rows, _FOREVER)
        self._retry = max(1, round(_RETRY_S / step_s))

    def begin(self, scene: int, seed: int, episode: int) -> None:
        """Draw the visits of an episode in a scene."""
        rows = slice(scene * self._count, (scene + 1) * self._count)
        draws = stream(seed, f"presence {self._group}", episode).uniform(size=(self._count, 2))
        self._due[rows] = self._steps(self._conf.arrive_s, draws[:, 0])
        self._stay[rows] = (
            _FOREVER
            if self._conf.stay_s is None
            else np.maximum(self._steps(self._conf.stay_s, draws[:, 1]), 1)
        )
        self._came_at[rows] = 0
        self.came[rows] = self._due[rows] == 0
        self.absent[rows] = ~self.came[rows]

    def _steps(self, bounds_s: tuple[float, float], draws: Array) -> Counts:
        low, high = bounds_s
        steps: Counts = np.rint((low + (high - low) * draws) / self._step_s).astype(np.int64)
        return steps

    def due(self, steps: Counts) -> list[int]:
        """Rows of agents that are to come now, or try again to; `steps` (N,) are those of their scenes."""
        since_due = steps - self._due
        return np.flatnonzero(~self.came & (since_due >= 0) & (since_due % self._retry == 0)).tolist()

    def admit(self, row: int, step: int) -> None:
        """The agent of `row` has come at the end of this step of its scene."""
        self.absent[row], self.came[row], self._came_at[row] = False, True, step

    def leaving(self, own_steps: Counts) -> Flags:
        """Flags (N,) of agents whose time is over; `own_steps` (N,) are those since they have come."""
        over: Flags = ~self.absent & (own_steps >= self._stay)
        return over

    def leave(self, mask: Flags) -> None:
        """The agents in `mask` (N,) are gone."""
        self.absent |= mask

    def own_steps(self, steps: Counts) -> Counts:
        """Control steps (N,) since each agent has come, of those of their scenes; 0 before."""
        return np.where(self.came, steps - self._came_at, 0)
