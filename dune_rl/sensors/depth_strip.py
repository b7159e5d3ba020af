"""A strip of depths: how far the nearest thing lies in each of a few bearings."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.sensors.beams import Beams, Elevation, FieldOfView, LargestRange, check_elevations, fan
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensor import MOUNT, Mount, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class DepthStripConf(SensorSettings):
    """Columns side by side over `fov_deg`, each a fan of `rows` rays between two elevations; range and mount.

    On level ground a ray below the horizon ends on the ground, which limits
    what its column can tell: the defaults keep that just out of range.
    """

    from_carrier: ClassVar = {"mount_b": "scanner_b"}
    # An estimate.
    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.02))

    sensor: Literal["depth_strip"] = "depth_strip"
    columns: int = Field(32, ge=1, le=4096, description="bearings, each the nearest of a fan of rays")
    rows: int = Field(4, ge=1, le=256, description="rays of a fan")
    fov_deg: FieldOfView = 86.0
    lowest_elevation_deg: Elevation = Field(-3.4, description="keeps level ground just out of range [deg]")
    highest_elevation_deg: Elevation = Field(13.8, description="of a fan [deg]")
    range_m: LargestRange = 5.0
    mount_b: Mount = MOUNT

    @model_validator(mode="after")
    def _sound(self) -> Self:
        check_elevations(self.lowest_elevation_deg, self.highest_elevation_deg, "rows", self.rows)
        return self


class DepthStrip(VectorSensor):
    """The reading "depth_strip", (N, columns) [m], of N agents, moving actors seen.

    Columns run counter-clockwise over the field of view, each bearing in the middle of its share. A depth is
    measured along the bearing, in the plane of the rover's forward and left axes: the nearest over the
    column's rays, and `range_m` where none of them meets anything that near. Of the `air`, tall grass ends a
    ray where half its light is lost, as for a camera's depth; haze does nothing to it.
    """

    def __init__(self, name: str, context: SensorContext, conf: DepthStripConf) -> None:
        self.conf = conf
        self._foliage = context.air.foliage
        bearing = np.deg2rad(conf.fov_deg) * ((np.arange(conf.columns) + 0.5) / conf.columns - 0.5)
        highest, lowest = np.deg2rad([conf.highest_elevation_deg, conf.lowest_elevation_deg])
        elevation = np.linspace(highest, lowest, conf.rows)
        self._level = np.cos(elevation)[:, None].astype(np.float32)
        directions_b = fan(bearing, elevation).reshape(-1, 3)
        self._beams = Beams(directions_b, conf.mount_b, conf.range_m, context.solid, context.meshes)
        high = np.full(conf.columns, conf.range_m)
        super().__init__(name, context.num_rows, np.zeros_like(high), high)

    def measure(self, now: GroupState, state: State) -> None:
        self._reading = self.depths(now.motion.position_w, now.motion.rotation, now.neighbours)

    def depths(self, position_w: Array, rotation: Array, neighbours: Array) -> Floats:
        """The reading of rovers at `position_w` (N, 3) [m], turned by `rotation` (N, 3, 3).

        `neighbours` (N, K, 7) are the poses of the actors: see `GroupState.neighbours`.
        """
        conf = self.conf
        ranges = self._beams.ranges(position_w, rotation, neighbours)
        if self._foliage is not None and not self._foliage.none:
            origins = self._beams.origin(position_w, rotation).astype(np.float32)
            directions = (self._beams.directions_b @ rotation.transpose(0, 2, 1)).astype(np.float32)
            met = self._foliage.median_ranges(origins, directions.reshape(-1, 3), ranges.ravel())
            ranges = np.minimum(ranges, met.reshape(ranges.shape))
        ranges = ranges.reshape(len(ranges), conf.rows, conf.columns)
        farthest = np.float32(conf.range_m)
        depths: Floats = np.where(ranges < farthest, ranges * self._level, farthest).min(axis=1)
        return depths
