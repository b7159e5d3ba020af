"""A planar LiDAR: many beams, of which the agent sees the nearest return in each segment."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.rays import RayScene
from dune_rl.settings import Settings

Array = NDArray[np.float64]


class LidarConf(Settings):
    """Beams, range and mount. The defaults are the paper's: 128 beams round the rover, 32 values, 12 m."""

    n_beams: int = Field(128, ge=1, le=16_384)
    n_segments: int = Field(32, ge=1, le=16_384)
    range_m: float = Field(12.0, gt=0.0, le=1_000.0)
    min_range_m: float = Field(0.1, ge=0.0)
    fov_rad: float = Field(2 * np.pi, gt=0.0, le=2 * np.pi)
    # Above and ahead of the chassis centre, as the published simulation mounts it.
    mount_b: tuple[float, float, float] = (0.174, 0.0, 0.196)

    @model_validator(mode="after")
    def _even_segments(self) -> Self:
        if self.n_beams % self.n_segments:
            raise ValueError(
                f"n_segments must divide n_beams ({self.n_segments} does not divide {self.n_beams})"
            )
        if self.min_range_m >= self.range_m:
            raise ValueError(f"min_range_m ({self.min_range_m}) must be less than range_m ({self.range_m})")
        return self


def beam_angles(conf: LidarConf) -> Array:
    """Bearing of every beam in the sensor frame [rad], shape (n_beams,).

    Beams run counter-clockwise from -fov/2. A full circle leaves out its last
    beam, which would repeat the first.
    """
    full_circle = np.isclose(conf.fov_rad, 2 * np.pi)
    return np.linspace(-conf.fov_rad / 2, conf.fov_rad / 2, conf.n_beams, endpoint=not full_circle)


class Lidar:
    """Ranges of M scenes, which share the static world and differ in their moving actors.

    `actor_shapes` are ray scenes in the actors' own frames, one per actor; equal
    objects are asked together.
    """

    def __init__(self, conf: LidarConf, static: RayScene, actor_shapes: list[RayScene]) -> None:
        self.conf = conf
        self._static = static
        angles = beam_angles(conf)
        self._beams_b = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
        self._groups = [
            (shape, np.flatnonzero([shape is other for other in actor_shapes]))
            for shape in dict.fromkeys(actor_shapes)
        ]

    def origin(self, position_w: Array, rotation: Array) -> Array:
        """Where the beams start [m], (M, 3), on robots at `position_w` (M, 3) turned by `rotation`."""
        return position_w + rotation @ np.asarray(self.conf.mount_b)

    def ends(self, origin: Array, rotation: Array, ranges: NDArray[np.float32]) -> Array:
        """Where beams of `ranges` (M, n_beams) end in the world [m], (M, n_beams, 3)."""
        return origin[:, None] + (self._beams_b * ranges[..., None]) @ rotation.transpose(0, 2, 1)

    def ranges(self, position_w: Array, rotation: Array, actor_poses: Array) -> NDArray[np.float32]:
        """Range along every beam [m], (M, n_beams): `range_m` where nothing returns.

        `position_w` (M, 3) and `rotation` (M, 3, 3) are the robots' poses,
        `actor_poses` (M, K, 4) the actors' x, y, z and yaw.
        """
        conf = self.conf
        scenes, n_beams = len(position_w), conf.n_beams
        origin = self.origin(position_w, rotation)
        directions = self._beams_b @ rotation.transpose(0, 2, 1)
        ranges = np.full(scenes * n_beams, conf.range_m, np.float32)
        origins32 = np.repeat(origin.astype(np.float32), n_beams, axis=0)
        directions32 = directions.reshape(-1, 3).astype(np.float32)
        self._static.shorten(origins32, directions32, ranges)
        for shape, columns in self._groups:
            ranges = self._past_actors(shape, actor_poses[:, columns], origin, directions, ranges)
        return np.maximum(ranges, np.float32(conf.min_range_m)).reshape(scenes, n_beams)

    def _past_actors(
        self,
        shape: RayScene,
        poses: Array,
        origin: Array,
        directions: Array,
        ranges: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """`ranges` (M * n_beams,), shortened by the actors of one shape at `poses` (M, K, 4)."""
        scenes, actors = poses.shape[:2]
        n_beams = self.conf.n_beams
        # Beams are carried into each actor's frame, so that one small ray scene serves them all.
        cos, sin = np.cos(poses[..., 3]), np.sin(poses[..., 3])
        offset = origin[:, None, :] - poses[..., :3]
        origins = np.empty((scenes, actors, n_beams, 3), np.float32)
        origins[..., 0] = (cos * offset[..., 0] + sin * offset[..., 1])[..., None]
        origins[..., 1] = (cos * offset[..., 1] - sin * offset[..., 0])[..., None]
        origins[..., 2] = offset[..., 2, None]
        x, y = directions[:, None, :, 0], directions[:, None, :, 1]
        cos, sin = cos[..., None], sin[..., None]
        carried = np.empty_like(origins)
        carried[..., 0] = cos * x + sin * y
        carried[..., 1] = cos * y - sin * x
        carried[..., 2] = directions[:, None, :, 2]
        shortened = np.repeat(ranges.reshape(scenes, 1, n_beams), actors, axis=1).ravel()
        shape.shorten(origins.reshape(-1, 3), carried.reshape(-1, 3), shortened)
        nearest: NDArray[np.float32] = shortened.reshape(scenes, actors, n_beams).min(axis=1)
        return nearest.ravel()

    def segments(self, ranges: NDArray[np.float32]) -> NDArray[np.float32]:
        """Nearest return of each segment of neighbouring beams [m], (M, n_segments)."""
        nearest: NDArray[np.float32] = ranges.reshape(len(ranges), self.conf.n_segments, -1).min(axis=2)
        return nearest
