"""The LiDAR's scan of a moment ago as it would look from here; differences from the present have moved."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.frames import rotation_from_yaw
from dune_rl.sensors.beam_loops import nearest_seen_from
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import LidarConf, LidarSensor
from dune_rl.sensors.sensor import VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


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
        return self.nearest(self._ends_w[(self._newest + 1) % len(self._ends_w)], origin_w, rotation)

    def nearest(self, ends_w: Floats, origin_w: Array, rotation: Array) -> Floats:
        """As `seen_from`, of the end points `ends_w` (N, B, 3)."""
        found = np.empty((len(ends_w), self._conf.n_segments), np.float32)
        nearest_seen_from(
            ends_w, origin_w.astype(np.float32), rotation.astype(np.float32), self._first_rad, self._per_rad,
            self._full_circle, self._limits, found,
        )  # fmt: skip
        return found


class LidarPastConf(SensorSettings):
    """A LiDAR's scan of a moment ago, as it would look from the present pose.

    Where it differs from the present scan, something has moved. Its rate, latency and faults are those of the
    LiDAR.
    """

    default_realism: ClassVar = LidarConf.default_realism

    sensor: Literal["lidar_past"] = "lidar_past"
    realism: None = Field(None, description="none of its own: its LiDAR's")
    lidar: str = Field("lidar", description="name of the LiDAR")
    past_s: float = Field(0.5, gt=0.0, le=5.0, description="age of the scan [s]")


class LidarPast(VectorSensor):
    """The reading `name`, (N, n_segments) [m]: the LiDAR's scan of `past_s` ago, seen from the present pose.

    It is carried over by the robot's true motion, or by its instruments where these are faulty.
    """

    def __init__(self, name: str, context: SensorContext, conf: LidarPastConf) -> None:
        sensor = context.sensor_of(conf.lidar)
        if not isinstance(sensor, LidarSensor):
            raise ConfigError(f"sensors.{name}.lidar must be the name of a LiDAR (got {conf.lidar!r})")
        self._sensor, self._lidar = sensor, sensor.lidar
        scan, rows = self._lidar.conf, context.num_rows
        limits_m = scan.min_range_m, scan.range_m
        super().__init__(name, rows, *(np.full(scan.n_segments, limit) for limit in limits_m))
        self._navigation = context.navigation
        self._past = PastScan(scan, rows, max(1, round(conf.past_s / context.step_s)))

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Take the present scan; the rows in `mask` (N,) have seen nothing else before."""
        self._take(now, mask)

    def measure(self, now: GroupState, state: State) -> None:
        self._take(now, None)

    def _take(self, now: GroupState, begun: Flags | None) -> None:
        motion = now.motion if self._navigation is None else self._navigation
        ranges, rotation = self._sensor.ranges, motion.rotation
        origin = self._lidar.origin(motion.position_w, rotation)
        if self._lidar.conf.rings_deg:
            # Their ranges are in the level plane.
            rotation = rotation_from_yaw(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
        if begun is None:
            self._lidar.store_ends(origin, rotation, ranges, self._past.advance())
        else:
            ends_w = np.empty((*ranges.shape, 3), np.float32)
            self._lidar.store_ends(origin, rotation, ranges, ends_w)
            self._past.restart(begun, ends_w)
        self._reading = self._past.seen_from(origin, rotation)
