"""The LiDAR as a sensor: its scan, and the scan of a moment ago beside it."""

from collections.abc import Collection

import numpy as np

from dune_rl.geometry.arrays import Flags
from dune_rl.sensors.lidar import Lidar
from dune_rl.sensors.medium import RangeEffect
from dune_rl.sensors.navigation import Navigation
from dune_rl.sensors.past_scan import PastScan
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.state.state import GroupState, State


class Scanner:
    """The readings `name` and "<name>_past", (N, n_segments) [m]; those that `wanted` names.

    The past scan is `delay_steps` control steps old, seen from the present pose. `effects` change the ranges
    of both: what beams meet in the air, and the faults of a real part. The past scan is carried over by the
    robot's true motion, or by `navigation` where there is one.
    """

    def __init__(
        self,
        lidar: Lidar,
        wanted: Collection[str],
        num_rows: int,
        delay_steps: int,
        effects: RangeEffect | None = None,
        name: str = "lidar",
        navigation: Navigation | None = None,
    ) -> None:
        self._lidar = lidar
        self._effects, self._navigation = effects, navigation
        self._names = [name, f"{name}_past"]
        self._wanted = wanted
        self._past = PastScan(lidar.conf, num_rows, delay_steps) if self._names[1] in wanted else None
        self._scan: Reading = np.zeros((num_rows, lidar.conf.n_segments), np.float32)
        self._past_scan = self._scan

    def bounds(self) -> dict[str, Bounds]:
        """Ranges lie between the LiDAR's smallest and largest."""
        conf = self._lidar.conf
        low = np.full(conf.n_segments, conf.min_range_m, np.float32)
        high = np.full(conf.n_segments, conf.range_m, np.float32)
        return {name: (low, high) for name in self._names if name in self._wanted}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Scan; the rows in `mask` (N,) have seen nothing else before."""
        self._look(now, mask)

    def measure(self, now: GroupState, state: State) -> None:
        """Scan once more."""
        self._look(now, None)

    def _look(self, now: GroupState, begun: Flags | None) -> None:
        position_w, rotation = now.motion.position_w, now.motion.rotation
        ranges = self._lidar.ranges(position_w, rotation, now.neighbours)
        if self._effects is not None:
            ranges = self._effects.applied(ranges, now)
        self._scan = self._lidar.segments(ranges)
        if self._past is None:
            return
        if self._navigation is not None:
            position_w, rotation = self._navigation.position_w, self._navigation.rotation
        origin = self._lidar.origin(position_w, rotation)
        if begun is None:
            self._lidar.store_ends(origin, rotation, ranges, self._past.advance())
        else:
            ends_w = np.empty((*ranges.shape, 3), np.float32)
            self._lidar.store_ends(origin, rotation, ranges, ends_w)
            self._past.restart(begun, ends_w)
        self._past_scan = self._past.seen_from(origin, rotation)

    def read(self) -> dict[str, Reading]:
        """The scans of the latest moment."""
        readings = zip(self._names, (self._scan, self._past_scan), strict=True)
        return {name: value.copy() for name, value in readings if name in self._wanted}
