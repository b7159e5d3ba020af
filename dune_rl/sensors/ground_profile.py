"""Heights of what fans of downward rays meet ahead of a robot: the ground as a depth camera sees it."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.sensors.beams import Beams, Elevation, FieldOfView, LargestRange, check_elevations, fan
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensor import MOUNT, Mount, VectorSensor, mount_position
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# A ray that points down by more than any slope to drive on, 27 degrees (its sine), and meets nothing so far
# away [m], is over a drop.
_STEEP, _DEEP_M = 0.454, 12.0


class GroundProfileConf(SensorSettings):
    """Columns side by side over `fov_deg`, each a fan of `rows` rays between two elevations.

    From a mount 0.33 m over level ground, the rays of the default elevations end on it 0.4 to 2.2 m ahead.
    """

    from_carrier: ClassVar = {"mount_b": "scanner_b", "standing_height_m": "standing_height_m"}
    # An estimate.
    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.02))

    sensor: Literal["ground_profile"] = "ground_profile"
    columns: int = Field(21, ge=1, le=256, description="bearings of rays")
    rows: int = Field(7, ge=1, le=256, description="rays of a fan")
    fov_deg: FieldOfView = 130.0
    lowest_elevation_deg: Elevation = Field(-40.0, description="of a fan [deg]")
    highest_elevation_deg: Elevation = Field(-8.5, description="of a fan [deg]")
    range_m: LargestRange = 4.0
    limit_m: float = Field(0.5, gt=0.0, le=100.0, description="readings are clipped to this either way [m]")
    mount_b: Mount = MOUNT
    standing_height_m: float | None = Field(
        None, ge=0.0, le=10.0, description="of the robot's origin over level ground [m]; null: its own"
    )

    @model_validator(mode="after")
    def _sound(self) -> Self:
        check_elevations(self.lowest_elevation_deg, self.highest_elevation_deg, "rows", self.rows)
        return self


class GroundProfile(VectorSensor):
    """The reading `name`, (N, rows * columns) [m]: heights of what the rays meet, over the robot's ground.

    Rows run from the lowest rays to the highest, columns counter-clockwise. Heights are vertical, by the
    robot's attitude, over the level plane `standing_height_m` below its origin, so that level ground reads 0.
    A ray that meets nothing reads the lower limit, as beyond an edge. Moving actors are seen.

    `points` (N, P, 3) are the hits [m], forward, left and up of the robot's ground in its level frame, and
    `sees` (N, P) tells which rays have one; `up` (N, 3) is the robot's vertical axis in that frame.
    Where `drops` (N, P), there is no ground: a ray that points so steeply down meets nothing, also far below.
    Its point is where it would meet the level of the robot's ground.
    """

    def __init__(self, name: str, context: SensorContext, conf: GroundProfileConf) -> None:
        highest = np.full(conf.rows * conf.columns, conf.limit_m)
        super().__init__(name, context.num_rows, -highest, highest)
        self._conf, self._navigation = conf, context.navigation
        bearing = np.deg2rad(conf.fov_deg) * ((np.arange(conf.columns) + 0.5) / conf.columns - 0.5)
        lowest, highest_up = np.deg2rad([conf.lowest_elevation_deg, conf.highest_elevation_deg])
        elevation = np.linspace(lowest, highest_up, conf.rows)
        self._mount_b = mount_position(conf.mount_b)
        self.points = np.zeros((context.num_rows, conf.rows * conf.columns, 3))
        self.sees, self.drops = np.zeros((2, *self.points.shape[:2]), bool)
        self.up = np.tile([0.0, 0.0, 1.0], (context.num_rows, 1))
        self._beams = Beams(
            fan(bearing, elevation).reshape(-1, 3),
            conf.mount_b,
            max(conf.range_m, _DEEP_M),
            context.solid,
            context.meshes,
        )

    def measure(self, now: GroupState, state: State) -> None:
        conf, motion = self._conf, now.motion
        ranges: Floats = self._beams.ranges(motion.position_w, motion.rotation, now.neighbours)
        known = motion.rotation if self._navigation is None else self._navigation.rotation
        level = _level(known).transpose(0, 2, 1)
        down = -(self._beams.directions_b @ level)[..., 2]
        self.drops = (down > _STEEP) & (ranges >= np.float32(max(conf.range_m, _DEEP_M)))
        over_m = (self._mount_b @ level)[:, 2] + (conf.standing_height_m or 0.0)
        ranges = np.where(self.drops, over_m[:, None] / np.maximum(down, _STEEP), ranges)
        hits_b = self._mount_b + ranges[..., None] * self._beams.directions_b
        self.points = hits_b @ level
        self.points[..., 2] += conf.standing_height_m or 0.0
        self.sees = (ranges < np.float32(conf.range_m)) & ~self.drops
        self.up = level[:, 2]
        self._store(np.where(self.sees, self.points[..., 2], -conf.limit_m))


def _level(rotation: Array) -> Array:
    """Rotations (N, 3, 3) from body frames to level frames with their headings."""
    cos, sin = rotation[:, 0, 0], rotation[:, 1, 0]
    length = np.maximum(np.hypot(cos, sin), 1e-9)
    cos, sin, zero = cos / length, sin / length, np.zeros(len(cos))
    back = np.stack([cos, sin, zero, -sin, cos, zero, zero, zero, zero + 1.0], axis=-1)
    found: Array = back.reshape(-1, 3, 3) @ rotation
    return found
