"""The scan of a moment ago as it would look from here: what differs from the present one has moved."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.sensors.lidar import LidarConf

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class PastScan:
    """Where the LiDAR beams of M scenes ended `delay_steps` control steps ago, seen from now.

    The robot's own motion is taken out: each end point is carried into the
    present sensor frame and counted in the segment in whose direction it now lies.
    """

    def __init__(self, conf: LidarConf, num_rows: int, delay_steps: int) -> None:
        self._conf = conf
        self._ends_w = np.zeros((delay_steps + 1, num_rows, conf.n_beams, 3), np.float32)
        self._newest = 0
        # Half a beam before the first, so that each beam lies in the middle of its share.
        self._first_rad = np.float32(-conf.fov_rad / 2 - conf.fov_rad / conf.n_beams / 2)
        self._per_rad = np.float32(conf.n_segments / conf.fov_rad)
        self._rows = np.arange(num_rows)[:, None] * conf.n_segments
        self._is_full_circle = bool(np.isclose(conf.fov_rad, 2 * np.pi))

    def restart(self, mask: NDArray[np.bool_], ends_w: Array) -> None:
        """Let the scenes in `mask` (M,) have seen nothing but the end points `ends_w` (M, n_beams, 3)."""
        self._ends_w[:, mask] = ends_w[mask]

    def push(self, ends_w: Array) -> None:
        """Add the end points (M, n_beams, 3) [m] of a control step."""
        self._newest = (self._newest + 1) % len(self._ends_w)
        self._ends_w[self._newest] = ends_w

    def seen_from(self, origin_w: Array, rotation: Array) -> Floats:
        """Nearest past end point in each segment [m], (M, n_segments), `range_m` where there is none.

        The sensors are at `origin_w` (M, 3), turned by `rotation` (M, 3, 3). An
        episode younger than the delay shows its first scan.
        """
        conf = self._conf
        ends_w = self._ends_w[(self._newest + 1) % len(self._ends_w)]
        ends_b = (ends_w - origin_w[:, None].astype(np.float32)) @ rotation.astype(np.float32)
        x, y = ends_b[..., 0], ends_b[..., 1]
        segment = np.floor((np.arctan2(y, x) - self._first_rad) * self._per_rad).astype(np.int64)
        if self._is_full_circle:
            segment %= conf.n_segments
        seen = (segment >= 0) & (segment < conf.n_segments)
        nearest = np.full(self._rows.size * conf.n_segments, conf.range_m, np.float32)
        np.minimum.at(nearest, (segment + self._rows)[seen], np.sqrt(x * x + y * y)[seen])
        return np.maximum(nearest, np.float32(conf.min_range_m)).reshape(self._rows.size, conf.n_segments)
