"""Recovery of bodies that are stuck: records what blocks them, and when they should back off."""

import numpy as np

from dune_rl.geometry.arrays import Array, Flags

# A body that has come no farther than this in this time does not move.
_STAYED_M = 0.1
_BLOCKED_S = 2.0
_IDLE_S = 4.0
_RECOVERY_S = 1.5
# Commands whose mean over the time is faster than this should have moved it.
_COMMANDED_MPS = 0.15
# What blocks it is taken for a disc of this radius before its bumper; the last few are kept.
_DISC_M = 0.2
_MOST_DISCS = 6


class StuckRecovery:
    """Detects which of N bodies do not move as commanded, and starts their recovery.

    `recovering` (N,) marks bodies that back off, for 1.5 s; `blocked` has, for each body, the discs
    (B, 3: x, y, radius) [m] that blocked its way.
    """

    def __init__(self, num_rows: int) -> None:
        self._anchors = np.zeros((num_rows, 2))
        # Times at the anchor and since the recovery began [s], and the way commanded at the anchor [m].
        self._stayed_s, self._recovery_s = np.zeros(num_rows), np.full(num_rows, np.inf)
        self._commanded_m, self._command_mps = np.zeros(num_rows), np.zeros(num_rows)
        self.blocked: list[Array] = [np.zeros((0, 3)) for _ in range(num_rows)]

    @property
    def recovering(self) -> Flags:
        """Flags (N,) of the bodies that should get away from where they are."""
        return self._recovery_s < _RECOVERY_S

    def reset(self, mask: Flags) -> None:
        """Clear the history of the bodies in `mask` (N,)."""
        self._anchors[mask] = np.inf
        self._recovery_s[mask] = np.inf
        self._command_mps[mask] = 0.0
        for row in np.flatnonzero(mask).tolist():
            self.blocked[row] = np.zeros((0, 3))

    def record_command(self, speed_mps: Array) -> None:
        """Record the speeds (N,) [m/s] that are commanded for the next step."""
        self._command_mps = speed_mps.copy()

    def update(self, poses: Array, waits: Flags, length_m: float, step_s: float) -> Flags:
        """Watch the bodies at `poses` (N, 3: x, y, yaw); flags (N,) of those that found a blockage.

        Bodies in `waits` (N,) have a reason not to move.
        """
        moved = np.hypot(*(poses[:, :2] - self._anchors).T) > _STAYED_M
        anew = moved | waits | ~np.isfinite(self._anchors[:, 0])
        self._anchors[anew] = poses[anew, :2]
        self._stayed_s = np.where(anew, 0.0, self._stayed_s + step_s)
        self._commanded_m = np.where(anew, 0.0, self._commanded_m + self._command_mps * step_s)
        self._recovery_s = self._recovery_s + step_s
        pushes = np.abs(self._commanded_m) > _COMMANDED_MPS * self._stayed_s
        blocked = (self._stayed_s >= _BLOCKED_S) & pushes & ~self.recovering
        idle = (self._stayed_s >= _IDLE_S) & ~pushes & ~self.recovering
        for row in np.flatnonzero(blocked).tolist():
            self._add_disc(row, poses[row], length_m)
        begins = blocked | idle
        self._recovery_s[begins] = 0.0
        self._anchors[begins] = poses[begins, :2]
        self._stayed_s[begins], self._commanded_m[begins] = 0.0, 0.0
        return blocked

    def _add_disc(self, row: int, pose: Array, length_m: float) -> None:
        ahead = np.sign(self._commanded_m[row]) * (length_m / 2 + 1.25 * _DISC_M)
        disc = [pose[0] + ahead * np.cos(pose[2]), pose[1] + ahead * np.sin(pose[2]), _DISC_M]
        self.blocked[row] = np.concatenate([self.blocked[row], [disc]])[-_MOST_DISCS:]
