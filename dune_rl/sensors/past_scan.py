"""The scan of a moment ago as it would look from here: what differs from the present one has moved."""

import numpy as np

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.sensors.beam_loops import nearest_seen_from
from dune_rl.sensors.lidar import LidarConf


class PastScan:
    """Where the LiDAR beams of N robots ended `delay_steps` control steps ago, seen from now.

    The robot's own motion is taken out: each end point is carried into the present sensor frame and counted
    in the segment in whose direction it now lies.
    """

    def __init__(self, conf: LidarConf, num_rows: int, delay_steps: int) -> None:
        self._conf = conf
        self._ends_w = np.zeros((delay_steps + 1, num_rows, conf.n_beams, 3), np.float32)
        self._newest = 0
        fov_rad = np.deg2rad(conf.fov_deg)
        # Half a beam before the first, so that each beam lies in the middle of its share.
        self._first_rad = np.float32(-fov_rad / 2 - fov_rad / conf.n_beams / 2)
        self._per_rad = np.float32(conf.n_segments / fov_rad)
        self._full_circle = bool(np.isclose(fov_rad, 2 * np.pi))
        self._limits = np.float32(conf.min_range_m), np.float32(conf.range_m)

    def restart(self, mask: Flags, ends_w: Array | Floats) -> None:
        """Let the rows in `mask` (N,) have seen nothing but the end points `ends_w` (N, n_beams, 3)."""
        self._ends_w[:, mask] = ends_w[mask]

    def advance(self) -> Floats:
        """The place (N, n_beams, 3) for the end points [m] of another control step, to be filled."""
        self._newest = (self._newest + 1) % len(self._ends_w)
        return self._ends_w[self._newest]

    def seen_from(self, origin_w: Array, rotation: Array) -> Floats:
        """Nearest past end point in each segment [m], (N, n_segments), `range_m` where there is none.

        The sensors are at `origin_w` (N, 3), turned by `rotation` (N, 3, 3). An episode younger than the
        delay shows its first scan.
        """
        ends_w = self._ends_w[(self._newest + 1) % len(self._ends_w)]
        found = np.empty((len(ends_w), self._conf.n_segments), np.float32)
        nearest_seen_from(
            ends_w,
            origin_w.astype(np.float32),
            rotation.astype(np.float32),
            self._first_rad,
            self._per_rad,
            self._full_circle,
            self._limits,
            found,
        )
        return found
