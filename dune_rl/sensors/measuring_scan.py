"""The LiDAR of the paper's published code, which measures for terms and is no sensor of an agent."""

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import Beams, LidarConf, beam_angles, fan
from dune_rl.state.state import Motion

# 20 beams for each of the 32 segments that its agents see.
DUNE_CODE_LIDAR = LidarConf(n_beams=640, n_segments=32, range_m=10.0, min_range_m=0.15)


class MeasuringScan:
    """Scans from where the body carries scanners; see `dune_rl.state.ScanQueries`.

    A return that is nearer than the smallest range is none, as in Gazebo, which reports it as -inf.
    """

    def __init__(self, context: SensorContext, conf: LidarConf = DUNE_CODE_LIDAR) -> None:
        self._conf = conf
        directions = fan(beam_angles(conf), np.zeros(1))[0]
        mount = context.carrier.scanner_b
        self._beams = Beams(directions, mount, conf.range_m, context.solid, context.meshes)

    def nearest_return(self, motion: Motion, neighbours: Array) -> Array:
        """Smallest range [m], (N,), of the beams that return; NaN where none does."""
        ranges = self._beams.ranges(motion.position_w, motion.rotation, neighbours)
        seen = (ranges >= self._conf.min_range_m) & (ranges < self._conf.range_m)
        nearest = np.where(seen, ranges, np.inf).min(axis=1).astype(np.float64)
        return np.where(np.isfinite(nearest), nearest, np.nan)
