"""The LiDAR as a sensor: its scan, and the scan of a moment ago beside it."""

from collections.abc import Collection

import numpy as np

from dune_rl.sensors.lidar import Lidar
from dune_rl.sensors.medium import RangeEffect
from dune_rl.sensors.past_scan import PastScan
from dune_rl.sensors.sensor import Bounds, Flags, Moment, Reading

# Farther than any LiDAR sees.
_NOWHERE_M = 1e6


class Scanner:
    """Those of the readings "lidar" and "lidar_past", (M, n_segments) [m], that are `wanted`.

    The past scan is `delay_steps` control steps old, seen from the present pose.
    Both see the `faults` of the beams, where there are any, and what they meet in the air.
    """

    def __init__(
        self,
        lidar: Lidar,
        wanted: Collection[str],
        num_scenes: int,
        delay_steps: int,
        faults: RangeEffect | None = None,
    ) -> None:
        self._lidar = lidar
        self._faults = faults
        self._wanted = wanted
        self._past = PastScan(lidar.conf, num_scenes, delay_steps) if "lidar_past" in wanted else None
        self._scan: Reading = np.zeros((num_scenes, lidar.conf.n_segments), np.float32)
        self._past_scan = self._scan

    def bounds(self) -> dict[str, Bounds]:
        """Ranges lie between the LiDAR's smallest and largest."""
        conf = self._lidar.conf
        low = np.full(conf.n_segments, conf.min_range_m, np.float32)
        high = np.full(conf.n_segments, conf.range_m, np.float32)
        return {name: (low, high) for name in ("lidar", "lidar_past") if name in self._wanted}

    def begin(self, mask: Flags, now: Moment) -> None:
        """Scan; the scenes in `mask` (M,) have seen nothing else before."""
        self._look(now, mask)

    def measure(self, now: Moment) -> None:
        """Scan once more."""
        self._look(now, None)

    def _look(self, now: Moment, begun: Flags | None) -> None:
        ranges = self._lidar.ranges(now.position_w, now.rotation, now.actor_poses)
        if self._faults is not None:
            ranges = self._faults.applied(ranges, now)
        self._scan = self._lidar.segments(ranges)
        if self._past is None:
            return
        origin = self._lidar.origin(now.position_w, now.rotation)
        # A beam that met nothing has no end: it must not come back as a wall at the end of its range.
        ended = np.where(ranges < self._lidar.conf.range_m, ranges, np.float32(_NOWHERE_M))
        ends_w = self._lidar.ends(origin, now.rotation, ended)
        if begun is None:
            self._past.push(ends_w)
        else:
            self._past.restart(begun, ends_w)
        self._past_scan = self._past.seen_from(origin, now.rotation)

    def read(self) -> dict[str, Reading]:
        """The scans of the latest moment."""
        readings = {"lidar": self._scan, "lidar_past": self._past_scan}
        return {name: value.copy() for name, value in readings.items() if name in self._wanted}
