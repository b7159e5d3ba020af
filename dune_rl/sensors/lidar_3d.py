"""A LiDAR of rings: range, intensity and segment of every beam."""

from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.shared_per_scene import BatchedRayScenes
from dune_rl.rendering.scenery import Segment, luminance
from dune_rl.sensors.beams import Elevation, LargestRange, bearings, check_elevations, columns_by_mesh, fan
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import ScannerConf
from dune_rl.sensors.medium import RangeEffect, effects_of
from dune_rl.sensors.realism.lidar import BeamFaults, LidarRealismConf
from dune_rl.sensors.sensor import PictureSensor, Reading, mount_position
from dune_rl.state.state import GroupState

Indices = NDArray[np.int64]

Lidar3dOutput = Literal["range", "intensity", "segmentation"]


class Lidar3dConf(ScannerConf):
    """Rings, beams, range and mount. The defaults are like a common sensor of 16 rings over 30 degrees.

    At `half_intensity_m` a return is half as bright as close by.
    """

    default_realism: ClassVar = LidarRealismConf.model_validate("velodyne_vlp16")

    sensor: Literal["lidar_3d"] = "lidar_3d"
    range_m: LargestRange = 30.0
    n_rings: int = Field(16, ge=1, le=256, description="from the highest to the lowest")
    n_beams: int = Field(512, ge=1, le=16_384, description="of a ring")
    lowest_elevation_deg: Elevation = Field(-15.0, description="of the lowest ring [deg]")
    highest_elevation_deg: Elevation = Field(15.0, description="of the highest [deg]")
    half_intensity_m: float = Field(
        10.0, gt=0.0, le=1_000.0, description="range at which a return is half as bright [m]"
    )
    outputs: tuple[Lidar3dOutput, ...] = Field(("range",), min_length=1, description="kinds of readings")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        check_elevations(self.lowest_elevation_deg, self.highest_elevation_deg, "n_rings", self.n_rings)
        if len(set(self.outputs)) < len(self.outputs):
            raise ValueError(f"outputs must differ from each other (got {list(self.outputs)})")
        return self

    def directions(self) -> Array:
        """Unit vectors (n_rings, n_beams, 3) along the beams, in the sensor frame, the highest ring first."""
        highest, lowest, fov = np.deg2rad(
            [self.highest_elevation_deg, self.lowest_elevation_deg, self.fov_deg]
        )
        return fan(bearings(fov, self.n_beams), np.linspace(highest, lowest, self.n_rings))


class Lidar3d(PictureSensor):
    """The readings "<name>_<output>", (N, n_rings, n_beams, 1).

    The first ring is the highest; beams run counter-clockwise from -fov/2, as those of the planar LiDAR.
    `range` [m] is `range_m` where nothing returns; `segmentation` holds bytes of `Segment`, SKY where nothing
    returns; `intensity`, in [0, 1], is that of matt surfaces: the albedo's luminance, times the cosine of the
    angle of incidence, over 1 + (range / half_intensity_m)². That is the LiDAR equation's inverse square far
    away, and even close by, where receivers see only part of their beam.

    The robot itself is not seen. What a beam meets in the air counts as VEGETATION where it is grass; a
    false return of haze is faint and has the segment SKY.
    """

    def __init__(self, name: str, context: SensorContext, conf: Lidar3dConf) -> None:
        limits_m = (conf.min_range_m, conf.range_m)
        limits: dict[str, tuple[int, float, float, type]] = {
            "range": (1, *limits_m, np.float32),
            "intensity": (1, 0.0, 1.0, np.float32),
            "segmentation": (1, 0, max(Segment), np.uint8),
        }
        shape = (conf.n_rings, conf.n_beams)
        super().__init__(name, context.num_rows, shape, {each: limits[each] for each in conf.outputs})
        self.conf, self._num_rows = conf, context.num_rows
        self._solid, self._surface = context.solid, context.surfaces
        self._groups = columns_by_mesh(context.meshes)
        self._brightness = [luminance(mesh.albedo) for mesh, _ in self._groups]
        self._directions_b = conf.directions().reshape(-1, 3).astype(np.float32)
        self._order = np.arange(len(self._directions_b))
        draws_name = name.replace("_", " ")
        self._effects: list[RangeEffect] = [
            *effects_of(context.air, draws_name, self._directions_b, conf.mount_b, limits_m)
        ]
        if conf.realism is not None:
            self._effects.append(BeamFaults(conf.realism, limits_m, draws_name))
        self._range_only = conf.outputs == ("range",)

    def _look(self, rows: Indices | None, now: GroupState) -> dict[str, Reading]:
        motion = now.motion
        if rows is None:
            return self._scan_at(now)
        if self._effects:
            return {name: values[rows] for name, values in self._scan_at(now).items()}
        cast = self._cast(motion.position_w[rows], motion.rotation[rows], now.neighbours[rows], rows)
        return self._outputs(*cast)

    def scan(self, position_w: Array, rotation: Array, neighbours: Array) -> dict[str, Reading]:
        """The readings in clear air of rovers at `position_w` (M, 3) [m], turned by `rotation` (M, 3, 3).

        `neighbours` (M, K, 7) are the poses of the actors: see `GroupState.neighbours`.
        """
        found = self._outputs(*self._cast(position_w, rotation, neighbours))
        return {f"{self._name}_{name}": values for name, values in found.items()}

    def _scan_at(self, now: GroupState) -> dict[str, Reading]:
        """The readings, with what beams meet in the air."""
        ranges, brightness, segments = self._cast(now.motion.position_w, now.motion.rotation, now.neighbours)
        farthest = np.float32(self.conf.range_m)
        for effect in self._effects:
            seen = effect.applied(ranges, now)
            if not self._range_only:
                lost = (seen >= farthest) & (ranges < farthest)
                segments[lost], brightness[lost] = Segment.SKY, 0.0
                if effect.segment is not None:
                    ended = (seen != ranges) & ~lost
                    segments[ended], brightness[ended] = effect.segment, np.float32(effect.luminance)
            ranges = seen
        return self._outputs(ranges, brightness, segments)

    def _cast(
        self, position_w: Array, rotation: Array, neighbours: Array, rows: Indices | None = None
    ) -> tuple[Floats, Floats, NDArray[np.uint8]]:
        """Ranges, albedo times incidence, and segments of all beams, each (N, beams); ranges alone if enough.

        `rows` (m,) are the agents' numbers, where these are not all.
        """
        conf = self.conf
        solid, surface = self._solid, self._surface
        if rows is not None:
            scene = rows // (self._num_rows // len(solid)) if isinstance(solid, BatchedRayScenes) else rows
            solid = solid.select_scenes(scene)
            # The brightness of faces is computed when it is first read: leave it where nothing reads it.
            surface = surface if self._range_only else surface.select_scenes(scene)
        scenes, count = len(position_w), len(self._directions_b)
        origin = position_w + rotation @ mount_position(conf.mount_b)
        origins32 = origin.astype(np.float32)
        directions = (self._directions_b @ rotation.transpose(0, 2, 1).astype(np.float32)).reshape(-1, 3)
        ranges = np.full(scenes * count, conf.range_m, np.float32)
        brightness = np.zeros(0 if self._range_only else len(ranges), np.float32)
        segments = np.zeros(len(brightness), np.uint8)
        if self._range_only:
            solid.shorten_ranges(origins32, directions, ranges)
        else:
            face, ranges, normal = solid.hits(origins32, directions, ranges)
            segments, albedo = surface.look_up(face)
            brightness = albedo * _incidence(normal, directions)
        # All round: no body is out of view.
        view = (np.zeros((scenes, 3)), np.inf)
        for (mesh, columns), albedo in zip(self._groups, self._brightness, strict=True):
            poses = neighbours[:, columns]
            own = directions.reshape(scenes, -1, 3), ranges.reshape(scenes, -1)
            if self._range_only:
                mesh.shorten_ranges(origin, own[0], poses, conf.range_m, own[1])
                continue
            hit = mesh.hits(origin, own[0], self._order, poses, conf.range_m, view, own[1])
            segments[hit.ray] = mesh.segment
            brightness[hit.ray] = albedo[hit.face] * _incidence(hit.normal, directions[hit.ray])
        rest = (scenes, 0 if self._range_only else count)
        return ranges.reshape(scenes, count), brightness.reshape(rest), segments.reshape(rest)

    def _outputs(self, ranges: Floats, brightness: Floats, segments: NDArray[np.uint8]) -> dict[str, Reading]:
        conf = self.conf
        found: dict[str, Reading] = {}
        for name in conf.outputs:
            if name == "range":
                values: Reading = np.maximum(ranges, np.float32(conf.min_range_m))
            elif name == "intensity":
                values = brightness / (1.0 + np.square(ranges / np.float32(conf.half_intensity_m)))
            else:
                values = segments
            found[name] = values.reshape(len(ranges), conf.n_rings, conf.n_beams, 1)
        return found


def _incidence(normal: Floats, directions: Floats) -> Floats:
    """Cosine (R,) of the angle between rays `directions` (R, 3) and normals (R, 3), either way round."""
    length = np.sqrt(np.einsum("ri,ri->r", normal, normal))
    cosine: Floats = np.abs(np.einsum("ri,ri->r", normal, directions)) / np.maximum(length, np.float32(1e-12))
    return np.minimum(cosine, np.float32(1.0))
