"""The LiDAR as a sensor, and its scan of a moment ago."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import Lidar, LidarConf, beam_angles
from dune_rl.sensors.medium import RangeEffect, effects_of
from dune_rl.sensors.past_scan import PastScan
from dune_rl.sensors.realism.lidar import BeamFaults
from dune_rl.sensors.sensor import Bounds, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class LidarSensor(VectorSensor):
    """The reading `name`, (N, n_segments) [m]: the nearest return of each segment of a scan.

    `lidar` is its geometry. `ranges` (N, n_beams) [m] are those of the latest scan, with what beams meet in
    the air and the faults of a real device.
    """

    def __init__(self, name: str, context: SensorContext, conf: LidarConf) -> None:
        super().__init__(name, context.num_rows, *scan_bounds(conf))
        self.lidar = Lidar(conf, context.solid, context.meshes)
        limits_m = (conf.min_range_m, conf.range_m)
        self._effects: list[RangeEffect] = [
            *effects_of(context.air, name, self.lidar.directions_b, conf.mount_b, limits_m)
        ]
        if conf.realism is not None:
            self._effects.append(BeamFaults(conf.realism, limits_m, name, beam_angles(conf)))
        self.ranges: Floats = np.zeros((context.num_rows, conf.n_beams), np.float32)

    def measure(self, now: GroupState, state: State) -> None:
        """Scan once more."""
        self.ranges = self.lidar.ranges(now.motion.position_w, now.motion.rotation, now.neighbours)
        for effect in self._effects:
            self.ranges = effect.applied(self.ranges, now)
        self._reading = self.lidar.segments(self.ranges)


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
        super().__init__(name, context.num_rows, *scan_bounds(self._lidar.conf))
        self._navigation = context.navigation
        delay_steps = max(1, round(conf.past_s / context.step_s))
        self._past = PastScan(self._lidar.conf, context.num_rows, delay_steps)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Take the present scan; the rows in `mask` (N,) have seen nothing else before."""
        self._take(now, mask)

    def measure(self, now: GroupState, state: State) -> None:
        """Take the LiDAR's latest scan, and look at an older one."""
        self._take(now, None)

    def _take(self, now: GroupState, begun: Flags | None) -> None:
        motion = now.motion if self._navigation is None else self._navigation
        ranges = self._sensor.ranges
        origin = self._lidar.origin(motion.position_w, motion.rotation)
        if begun is None:
            self._lidar.store_ends(origin, motion.rotation, ranges, self._past.advance())
        else:
            ends_w = np.empty((*ranges.shape, 3), np.float32)
            self._lidar.store_ends(origin, motion.rotation, ranges, ends_w)
            self._past.restart(begun, ends_w)
        self._reading = self._past.seen_from(origin, motion.rotation)


def scan_bounds(conf: LidarConf) -> Bounds:
    """Lowest and highest values (n_segments,) of a scan [m]."""
    low = np.full(conf.n_segments, conf.min_range_m, np.float32)
    return low, np.full(conf.n_segments, conf.range_m, np.float32)
