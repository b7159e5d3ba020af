"""A grid of ground heights ahead of the rover."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.frames import clip
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.navigation import KnownPose
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensor import VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# No hill or wall rises farther than this over a rover.
_HIGHEST_M = 1_000.0


class HeightScanConf(SensorSettings):
    """Size and place of the grid, and what it shows.

    `source=solid` looks down from `above_m` over the ground on which the robot stands and sees decks, walls
    and everything else that is solid and still.
    """

    from_carrier: ClassVar = {"standing_height_m": "standing_height_m"}
    # An estimate.
    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.02))

    sensor: Literal["height_scan"] = "height_scan"
    rows: int = Field(11, ge=1, le=256, description="points ahead")
    columns: int = Field(11, ge=1, le=256, description="points across")
    spacing_m: float = Field(0.2, gt=0.0, le=10.0, description="between neighbouring points [m]")
    ahead_m: float = Field(0.4, ge=-100.0, le=100.0, description="of the first row, from the robot [m]")
    limit_m: float = Field(1.0, gt=0.0, le=100.0, description="readings are clipped to this either way [m]")
    source: Literal["terrain", "solid"] = Field("solid", description="all that is solid, or bare terrain")
    above_m: float = Field(1.0, gt=0.0, le=100.0, description="what is wholly higher is not seen [m]")
    standing_height_m: float | None = Field(
        None, ge=0.0, le=10.0, description="of the robot's origin over level ground [m]; null: its own"
    )

    @model_validator(mode="after")
    def _sees_its_limit(self) -> Self:
        if self.source == "solid" and self.above_m < self.limit_m:
            raise ValueError(
                f"above_m ({self.above_m}) must be at least limit_m ({self.limit_m}): "
                "what is higher than above_m is not seen"
            )
        return self


class HeightScan(VectorSensor):
    """The reading "height_scan", (N, rows * columns) [m], of N agents.

    Frame: the rover's position and yaw alone; however it rolls or pitches, the grid stays level. Row by row
    from the nearest, each from right to left. Heights are over the plane `standing_height_m` below the
    robot's origin, so that level ground reads 0. With `source=solid`, what hangs wholly higher than `above_m`
    is overhead and not seen; walls and hills that reach higher read the upper limit, and where there is no
    ground at all, the lower. Moving actors are not seen. A robot that navigates by faulty instruments reads a
    map where it believes to be: by its receiver, and its heading by its inertial unit.
    """

    def __init__(self, name: str, context: SensorContext, conf: HeightScanConf) -> None:
        self.conf = conf
        self._solid, self._terrain, self._navigation = context.solid, context.terrain, context.navigation
        ahead = conf.ahead_m + conf.spacing_m * np.arange(conf.rows)
        left = conf.spacing_m * (np.arange(conf.columns) - (conf.columns - 1) / 2)
        self._grid = np.stack(np.meshgrid(ahead, left, indexing="ij"), axis=-1).reshape(-1, 2)
        highest = np.full(len(self._grid), conf.limit_m, np.float32)
        super().__init__(name, context.num_rows, -highest, highest)

    def measure(self, now: GroupState, state: State) -> None:
        own = KnownPose.of(self._navigation, now)
        self._reading = self.heights(own.position_w, own.yaw)

    def points(self, position_w: Array, yaw: Array) -> Array:
        """Where heights are asked for, (N, rows * columns, 2) [m] in the world.

        The rovers are at `position_w` (N, 3) and head `yaw` (N,) [rad].
        """
        cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        x, y = self._grid.T
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + position_w[:, None, :2]

    def heights(self, position_w: Array, yaw: Array) -> Floats:
        """The reading of rovers at `position_w` (N, 3) [m] that head `yaw` (N,) [rad]."""
        conf = self.conf
        xy = self.points(position_w, yaw)
        base = position_w[:, 2, None] - (conf.standing_height_m or 0.0)
        if conf.source == "terrain":
            heights = self._terrain.height(xy) - base
        else:
            heights = self._solid_heights(xy, base)
        return clip(heights, -conf.limit_m, conf.limit_m).astype(np.float32)

    def _solid_heights(self, xy: Array, base: Array) -> Array:
        """Heights (N, P) [m] of what is solid at `xy` (N, P, 2), over `base` (N, 1)."""
        above_m, limit_m = self.conf.above_m, self.conf.limit_m
        scenes, count = xy.shape[:2]
        start = np.empty((scenes, count, 3), np.float32)
        start[..., :2] = xy
        start[..., 2] = base + above_m
        origins = start.reshape(-1, 3)
        upward = np.zeros_like(origins)
        upward[:, 2] = 1.0
        depth = np.full(len(origins), above_m + limit_m, np.float32)
        self._solid.shorten_ranges(origins, -upward, depth)
        # A ray that starts inside a wall or under a hill would miss its top: from there, the first
        # surface upward is met from behind.
        over = self._solid.hits(origins, upward, np.full(len(origins), _HIGHEST_M, np.float32))
        inside = (over.face >= 0) & (over.normal[:, 2] > 0.0)
        return np.where(inside, limit_m, above_m - depth).reshape(scenes, count)
