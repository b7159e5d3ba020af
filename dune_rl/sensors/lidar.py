"""A planar LiDAR: many beams, of which the agent sees the nearest return in each segment."""

from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.shared_per_scene import AnyRays
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.sensors.beam_loops import find_ends, nearest_in_segments, turn_beams
from dune_rl.sensors.mesh_columns import columns_by_mesh
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.sensor import MOUNT, Mount, mount_position
from dune_rl.sensors.settings import SensorSettings

# Farther than any LiDAR sees.
_NOWHERE_M = 1e6


class LidarConf(SensorSettings):
    """Beams, range and mount. The defaults are the paper's: 128 beams round the rover, 32 values, 12 m."""

    from_carrier: ClassVar = {"mount_b": "scanner_b"}
    default_realism: ClassVar = LidarRealismConf.model_validate("rplidar_a2m8")

    sensor: Literal["lidar"] = "lidar"
    realism: LidarRealismConf | None = None
    n_beams: int = Field(128, ge=1, le=16_384, description="beams of a scan")
    n_segments: int = Field(
        32, ge=1, le=16_384, description="values observed: the nearest return of equal runs of beams"
    )
    range_m: float = Field(
        12.0, gt=0.0, le=1_000.0, description="largest reading, and the reading where nothing is hit [m]"
    )
    min_range_m: float = Field(0.1, ge=0.0, description="smallest reading [m]")
    fov_deg: float = Field(
        360.0, gt=0.0, le=360.0, description="angle that the scan spans, centred ahead [deg]"
    )
    mount_b: Mount = MOUNT

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
    """Bearing of every beam in the sensor frame [rad], shape (n_beams,): `bearings` of its field of view."""
    return bearings(float(np.deg2rad(conf.fov_deg)), conf.n_beams)


def bearings(fov_rad: float, count: int) -> Array:
    """Bearings (count,) [rad] in the sensor frame, counter-clockwise from -fov/2.

    A full circle leaves out its last beam, which would repeat the first.
    """
    full_circle = np.isclose(fov_rad, 2 * np.pi)
    return np.linspace(-fov_rad / 2, fov_rad / 2, count, endpoint=not full_circle)


def fan(bearing: Array, elevation: Array) -> Array:
    """Unit vectors (E, B, 3) at bearings (B,) and elevations (E,) [rad].

    Sensor frame: x forward, y left, z up.
    """
    level, up = np.cos(elevation)[:, None], np.sin(elevation)[:, None]
    axes = [level * np.cos(bearing), level * np.sin(bearing), np.broadcast_to(up, (len(up), len(bearing)))]
    return np.stack(axes, axis=-1)


def check_elevations(lowest_deg: float, highest_deg: float, name: str, count: int) -> None:
    """Raise ValueError unless both can bound a fan of `count` elevations, which the setting `name` tells."""
    sound = lowest_deg < highest_deg if count > 1 else lowest_deg == highest_deg
    if not sound:
        rule = "must be less than" if count > 1 else "must equal"
        raise ValueError(
            f"lowest_elevation_deg ({lowest_deg:g}) {rule} highest_elevation_deg ({highest_deg:g}) "
            f"where {name}={count}"
        )


class Beams:
    """Rays from a mount on N robots, cast at the static world and at the moving bodies of each scene.

    `directions_b` (P, 3) are unit vectors and `mount_b` (3,) [m] is where they start, both in the body frame.
    `meshes` are those of the other moving bodies, one for each column of `neighbours`.
    """

    def __init__(
        self,
        directions_b: Array,
        mount_b: Mount,
        range_m: float,
        static: AnyRays,
        meshes: Sequence[MovingMesh],
    ) -> None:
        self.directions_b = directions_b
        self._mount_b = mount_position(mount_b)
        self._range_m = range_m
        self._static = static
        self._meshes = columns_by_mesh(meshes)

    def origin(self, position_w: Array, rotation: Array) -> Array:
        """Where the rays start [m], (M, 3), on robots at `position_w` (M, 3) turned by `rotation`."""
        return position_w + rotation @ self._mount_b

    def ranges(self, position_w: Array, rotation: Array, neighbours: Array) -> Floats:
        """Range along every ray [m], (N, P): `range_m` where nothing returns.

        `position_w` (N, 3) and `rotation` (N, 3, 3) are the robots' poses, `neighbours` (N, K, 7) the
        poses of the other moving bodies: see `GroupState.neighbours`.
        """
        rows, count = len(position_w), len(self.directions_b)
        origin = self.origin(position_w, rotation)
        directions = np.empty((rows, count, 3))
        directions32 = np.empty((rows, count, 3), np.float32)
        turn_beams(self.directions_b, rotation, directions, directions32)
        ranges = np.full((rows, count), self._range_m, np.float32)
        self._static.shorten_ranges(
            origin.astype(np.float32), directions32.reshape(-1, 3), ranges.reshape(-1)
        )
        for mesh, columns in self._meshes:
            poses = neighbours if len(self._meshes) == 1 else neighbours[:, columns]
            mesh.shorten_ranges(origin, directions, poses, self._range_m, ranges)
        return ranges


class Lidar:
    """Ranges of N robots in M scenes, which differ in their moving bodies and, batched, in the static world.

    `meshes` are those of the other moving bodies, one for each column of `neighbours`. Unit vectors along
    the beams in the body frame are `directions_b` (n_beams, 3).
    """

    def __init__(self, conf: LidarConf, static: AnyRays, meshes: Sequence[MovingMesh]) -> None:
        self.conf = conf
        self.directions_b = fan(beam_angles(conf), np.zeros(1))[0]
        self._beams = Beams(self.directions_b, conf.mount_b, conf.range_m, static, meshes)

    def origin(self, position_w: Array, rotation: Array) -> Array:
        """Where the beams start [m], (M, 3), on robots at `position_w` (M, 3) turned by `rotation`."""
        return self._beams.origin(position_w, rotation)

    def store_ends(self, origin: Array, rotation: Array, ranges: Floats, found: Floats) -> None:
        """Write where beams of `ranges` (M, n_beams) end in the world [m] into `found` (M, n_beams, 3).

        A beam that meets nothing ends far away, not as a wall at its range.
        """
        limits = np.float32(self.conf.range_m), np.float32(_NOWHERE_M)
        find_ends(self.directions_b, ranges, limits, origin, rotation, found)

    def ranges(self, position_w: Array, rotation: Array, neighbours: Array) -> Floats:
        """Range along every beam [m], (M, n_beams): `range_m` where nothing returns.

        `position_w` (M, 3) and `rotation` (M, 3, 3) are the robots' poses,
        `neighbours` (M, K, 7) the actors' poses.
        """
        ranges = self._beams.ranges(position_w, rotation, neighbours)
        return np.maximum(ranges, np.float32(self.conf.min_range_m), out=ranges)

    def segments(self, ranges: Floats) -> Floats:
        """Nearest return of each segment of neighbouring beams [m], (M, n_segments)."""
        nearest = np.empty((len(ranges), self.conf.n_segments), np.float32)
        nearest_in_segments(ranges, nearest)
        return nearest
