"""A planar LiDAR: many beams, of which the agent sees the nearest return in each segment."""

from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.shared_per_scene import AnyRays
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.sensors.beam_loops import find_ends, nearest_in_segments, nearest_upright
from dune_rl.sensors.beams import Beams, Elevation, FieldOfView, LargestRange, bearings, fan
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.medium import RangeEffect, effects_of
from dune_rl.sensors.realism.lidar import BeamFaults, LidarRealismConf
from dune_rl.sensors.sensor import MOUNT, Mount, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, Motion, State

# Farther than any LiDAR sees.
_NOWHERE_M = 1e6


# A scan of all rings has no more rays.
_MOST_RAYS = 2**18


class ScannerConf(SensorSettings):
    """Range, field of view and mount of a LiDAR."""

    from_carrier: ClassVar = {"mount_b": "scanner_b"}

    realism: LidarRealismConf | None = None
    range_m: LargestRange = 12.0
    min_range_m: float = Field(0.1, ge=0.0, description="smallest reading [m]")
    fov_deg: FieldOfView = 360.0
    mount_b: Mount = MOUNT

    @model_validator(mode="after")
    def _rising_range(self) -> Self:
        if self.min_range_m >= self.range_m:
            raise ValueError(f"min_range_m ({self.min_range_m}) must be less than range_m ({self.range_m})")
        return self


class LidarConf(ScannerConf):
    """Beams, range and mount. The defaults are the paper's: 128 beams round the rover, 32 values, 12 m.

    With `rings_deg`, there are as many beams in each ring, and a scan has the nearest upright thing of each
    bearing: slopes are no obstacles, and those who stand on one are seen from below and above it.
    """

    default_realism: ClassVar = LidarRealismConf.model_validate("rplidar_a2m8")

    sensor: Literal["lidar"] = "lidar"
    n_beams: int = Field(128, ge=1, le=16_384, description="beams of a scan")
    n_segments: int = Field(32, ge=1, le=16_384, description="values observed: nearest returns of beams")
    rings_deg: tuple[Elevation, ...] = Field(
        (), max_length=128, description="elevations of the rings of a LiDAR of several, rising [deg]; (): one"
    )

    @model_validator(mode="after")
    def _sound_rings(self) -> Self:
        if len(self.rings_deg) == 1 or any(np.diff(self.rings_deg) <= 0.0):
            raise ValueError(
                f"rings_deg must be at least two rising elevations, or none (got {list(self.rings_deg)})"
            )
        if len(self.rings_deg) * self.n_beams > _MOST_RAYS:
            raise ValueError(
                f"{len(self.rings_deg)} rings of n_beams={self.n_beams} are more than {_MOST_RAYS:,} rays: "
                "give fewer rings_deg, or fewer beams"
            )
        return self

    @model_validator(mode="after")
    def _even_segments(self) -> Self:
        if self.n_beams % self.n_segments:
            raise ValueError(
                f"n_segments must divide n_beams ({self.n_segments} does not divide {self.n_beams})"
            )
        return self


# Of the paper's published code: 20 beams for each of the 32 segments that its agents see.
DUNE_CODE_LIDAR = LidarConf(n_beams=640, n_segments=32, range_m=10.0, min_range_m=0.15)


def beam_angles(conf: LidarConf) -> Array:
    """Bearing of every beam in the sensor frame [rad], shape (n_beams,): `bearings` of its field of view."""
    return bearings(float(np.deg2rad(conf.fov_deg)), conf.n_beams)


class Lidar(Beams):
    """Ranges of N robots in M scenes, which differ in their moving bodies and, batched, in the static world.

    Unit vectors along the beams in the body frame are `directions_b` (n_beams, 3).
    """

    def __init__(self, conf: LidarConf, static: AnyRays, meshes: Sequence[MovingMesh]) -> None:
        directions_b = fan(beam_angles(conf), np.zeros(1))[0]
        super().__init__(directions_b, conf.mount_b, conf.range_m, static, meshes)
        self.conf = conf

    def store_ends(self, origin: Array, rotation: Array, ranges: Floats, found: Floats) -> None:
        """Write where beams of `ranges` (N, n_beams) end in the world [m] into `found` (N, n_beams, 3).

        A beam that meets nothing ends far away, not as a wall at its range.
        """
        limits = np.float32(self.conf.range_m), np.float32(_NOWHERE_M)
        find_ends(self.directions_b, ranges, limits, origin, rotation, found)

    def ranges(self, position_w: Array, rotation: Array, neighbours: Array) -> Floats:
        """As `Beams.ranges`, at least `min_range_m`."""
        ranges = super().ranges(position_w, rotation, neighbours)
        return np.maximum(ranges, np.float32(self.conf.min_range_m), out=ranges)

    def segments(self, ranges: Floats) -> Floats:
        """Nearest return of each segment of neighbouring beams [m], (N, n_segments)."""
        nearest = np.empty((len(ranges), self.conf.n_segments), np.float32)
        nearest_in_segments(ranges, nearest)
        return nearest


class LidarSensor(VectorSensor):
    """The reading `name`, (N, n_segments) [m]: the nearest return of each segment of a scan.

    `lidar` is its geometry. `ranges` (N, n_beams) [m] are those of the latest scan, with what beams meet in
    the air and the faults of a real device. Of several rings they are distances in the level plane, by the
    robot's attitude.
    """

    def __init__(self, name: str, context: SensorContext, conf: LidarConf) -> None:
        limits_m = conf.min_range_m, conf.range_m
        super().__init__(name, context.num_rows, *(np.full(conf.n_segments, limit) for limit in limits_m))
        self.lidar = Lidar(conf, context.solid, context.meshes)
        self._navigation = context.navigation
        self._rings: Beams | None = None
        cast: Beams = self.lidar
        if conf.rings_deg:
            directions_b = fan(beam_angles(conf), np.deg2rad(conf.rings_deg)).reshape(-1, 3)
            cast = Beams(directions_b, conf.mount_b, conf.range_m, context.solid, context.meshes)
            self._rings = cast
        self._effects: list[RangeEffect] = [
            *effects_of(context.air, name, cast.directions_b, conf.mount_b, limits_m)
        ]
        if conf.realism is not None:
            level = None if conf.rings_deg else beam_angles(conf)
            self._effects.append(BeamFaults(conf.realism, limits_m, name, level))
        self.ranges: Floats = np.zeros((context.num_rows, conf.n_beams), np.float32)

    def measure(self, now: GroupState, state: State) -> None:
        motion, conf = now.motion, self.lidar.conf
        cast = self._rings or self.lidar
        ranges = cast.ranges(motion.position_w, motion.rotation, now.neighbours)
        for effect in self._effects:
            ranges = effect.applied(ranges, now)
        if self._rings is not None:
            known = motion.rotation if self._navigation is None else self._navigation.rotation
            shape = len(ranges), len(conf.rings_deg), conf.n_beams
            rises = (known[:, 2] @ self._rings.directions_b.T).reshape(shape)
            found = np.empty((len(ranges), conf.n_beams), np.float32)
            nearest_upright(ranges.reshape(shape), rises, conf.min_range_m, conf.range_m, found)
            ranges = found
        self.ranges = ranges
        self._reading = self.lidar.segments(self.ranges)


class MeasuringScan:
    """The LiDAR of the paper's published code, which measures for terms; see `dune_rl.state.ScanQueries`.

    A return that is nearer than the smallest range is none, as in Gazebo, which reports it as -inf.
    """

    def __init__(self, context: SensorContext, conf: LidarConf = DUNE_CODE_LIDAR) -> None:
        self._conf = conf
        directions, mount_b = fan(beam_angles(conf), np.zeros(1))[0], context.carrier.scanner_b
        self._beams = Beams(directions, mount_b, conf.range_m, context.solid, context.meshes)

    def nearest_return(self, motion: Motion, neighbours: Array) -> Array:
        """Smallest range [m], (N,), of the beams that return; NaN where none does."""
        ranges = self._beams.ranges(motion.position_w, motion.rotation, neighbours)
        seen = (ranges >= self._conf.min_range_m) & (ranges < self._conf.range_m)
        nearest = np.where(seen, ranges, np.inf).min(axis=1).astype(np.float64)
        return np.where(np.isfinite(nearest), nearest, np.nan)
