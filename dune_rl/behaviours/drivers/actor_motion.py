"""Velocities and yaw rates of moving bodies, from their true poses."""

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import POSE_COLUMNS, wrap_angle

# Time constant of the filter of yaw rates [s].
_FILTER_S = 0.2
# A body that turns by more within a step has turned round, and goes straight on.
_TURNED_ROUND_RAD = 1.0


class ActorMotion:
    """Estimates how the K bodies beside each of N rows move, by the change of their poses."""

    def __init__(self, num_rows: int) -> None:
        self._poses = np.zeros((num_rows, 0, POSE_COLUMNS))
        self._yaw_rates = np.zeros((num_rows, 0))
        self._begun = np.ones(num_rows, bool)

    def forget(self, mask: Flags) -> None:
        """Forget the past of the rows in `mask` (N,)."""
        self._begun = self._begun | mask

    def estimate(self, poses: Array, begins: Flags, step_s: float, radius_m: float) -> Array:
        """The bodies at `poses` (N, K, 7: see `GroupState.neighbours`), as (N, K, 6): x, y [m], velocities
        [m/s], yaw rate [rad/s] and `radius_m`; at rest in rows that begin.
        """
        if self._poses.shape != poses.shape:
            self._poses, self._yaw_rates = poses.copy(), np.zeros(poses.shape[:2])
            self._begun[:] = True
        known = ~(self._begun | begins)[:, None]
        moved = np.where(known[..., None], poses[..., :2] - self._poses[..., :2], 0.0)
        turned = wrap_angle(poses[..., 3] - self._poses[..., 3])
        share = min(1.0, step_s / _FILTER_S)
        rates = self._yaw_rates + share * (turned / step_s - self._yaw_rates)
        self._yaw_rates = np.where(known & (np.abs(turned) < _TURNED_ROUND_RAD), rates, 0.0)
        self._poses = poses.copy()
        self._begun = np.zeros(len(poses), bool)
        radius = np.full(poses.shape[:2], radius_m)
        parts = poses[..., :2], moved / step_s, np.stack([self._yaw_rates, radius], axis=-1)
        return np.concatenate(parts, axis=-1)
