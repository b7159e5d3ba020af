"""A camera on every rover: colours, depth, segments and normals of all scenes' pictures in one go."""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.shared_per_scene import BatchedQueries
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.beams import columns_by_mesh
from dune_rl.sensors.lens import Lens, LensConf
from dune_rl.sensors.pixels import depths_along_axis, look_up_colours, tile_order, unpack_colours
from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.presets import PRESETS
from dune_rl.sensors.sensor import MOUNT, Mount, mount_position
from dune_rl.sensors.settings import SensorSettings

_CLEAR = ParticipatingMedia()

Output = Literal["rgb", "grey", "depth", "segmentation", "normals"]


class CameraConf(LensConf, SensorSettings):
    """Lens, mount and outputs. The defaults are the paper's: 64 by 64 pixels, 60 degrees, RGB.

    The depth is `range_m` where nothing is seen.
    """

    from_carrier: ClassVar = {"mount_b": "camera_b", "pitch_deg": "camera_pitch_deg"}
    # The depth of one device and the colours of another.
    default_realism: ClassVar = CameraRealismConf.model_validate(
        {**PRESETS["realsense_d435"].settings, **PRESETS["raspberry_pi_v2"].settings}
    )

    sensor: Literal["camera"] = "camera"
    realism: CameraRealismConf | None = None
    outputs: tuple[Output, ...] = Field(("rgb",), min_length=1, description="kinds of pictures")
    mount_b: Mount = MOUNT
    pitch_deg: float | None = Field(None, ge=-90.0, le=90.0, description="downward [deg]; null: the robot's")
    range_m: float = Field(100.0, gt=0.0, le=10_000.0, description="how far it sees [m]")

    @model_validator(mode="after")
    def _outputs_differ(self) -> Self:
        if len(set(self.outputs)) < len(self.outputs):
            raise ValueError(f"outputs must differ from each other (got {list(self.outputs)})")
        return self


class Camera:
    """Pictures of M scenes, which share the static world and differ in their moving actors.

    A picture is (height, width, channels), its first row at the top. `rgb` and `grey` are bytes for a screen,
    `segmentation` bytes of `Segment`; `depth` [m] is measured along the optical axis of a pinhole, along the
    ray of a fisheye; `normals` are unit vectors in the camera frame (x forward, y left, z up), zero where
    nothing is seen.

    Of the `air`, haze fades colours alone. Tall grass hides what is behind it
    from colours, depth and segmentation: where it takes half the light, depth
    is the range of that and the segment VEGETATION. Normals are of what is solid.
    """

    def __init__(
        self,
        conf: CameraConf,
        baked: BakedScenery,
        meshes: Sequence[MovingMesh],
        air: ParticipatingMedia = _CLEAR,
    ) -> None:
        self.conf, self._air, self._baked = conf, air, baked
        self._meshes = columns_by_mesh(meshes)
        lens = Lens(conf)
        pitch = np.deg2rad(conf.pitch_deg or 0.0)
        cos, sin = np.cos(pitch), np.sin(pitch)
        self._tilt = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
        self._directions = lens.directions.reshape(-1, 3)
        self._directions_b = np.ascontiguousarray(self._directions @ self._tilt.T, np.float32)
        ahead = self._directions[:, 0] if conf.projection == "pinhole" else np.ones(len(self._directions))
        self._cosines = ahead.astype(np.float32)
        self._order = tile_order(conf.height, conf.width)
        # Whatever lies within this angle of the axis may be in the picture.
        self._half_angle = float(np.arccos(np.clip(self._directions[:, 0].min(), -1.0, 1.0)))
        self._coloured = bool({"rgb", "grey"} & set(conf.outputs))
        rows, columns = baked.ground.shape[:2]
        xmin, xmax, ymin, ymax = baked.terrain.extent
        self._corner = np.array([xmin, ymin])
        self._texels = np.array([columns / (xmax - xmin), rows / (ymax - ymin)], np.float32)
        self._last_texel = np.array([columns - 1, rows - 1], np.float32)
        self._ground = _packed(baked.ground.reshape(-1, 3))
        self._faces = _packed(baked.faces)
        self._sky = _packed(baked.sky)
        if baked.texture is not None:
            # Index -1, a miss, finds the last entry.
            ground = np.zeros(baked.ground_faces, bool)
            self._pictured = np.concatenate([ground, baked.texture.textured, [False]])
            steps = np.einsum("ij,ij->i", self._directions[1:], self._directions[:-1])
            self._pixel_rad = np.float32(np.median(np.arccos(np.clip(steps, -1.0, 1.0))))

    def origin(self, position_w: Array, rotation: Array) -> Array:
        """Where the cameras are [m], (M, 3), on robots at `position_w` (M, 3) turned by `rotation`."""
        return position_w + rotation @ mount_position(self.conf.mount_b)

    def frames(self, position_w: Array, rotation: Array, neighbours: Array) -> dict[str, NDArray[Any]]:
        """A picture (M, height, width, channels) of each output.

        `position_w` (M, 3) and `rotation` (M, 3, 3) are the robots' poses,
        `neighbours` (M, K, 7) the poses of the other moving bodies.
        """
        scenes, pixels, outputs = len(position_w), len(self._directions_b), self.conf.outputs
        origin = self.origin(position_w, rotation)
        directions = self._directions_b @ rotation.transpose(0, 2, 1).astype(np.float32)
        directions32 = directions.reshape(-1, 3)
        ranges = np.full(scenes * pixels, self.conf.range_m, np.float32)
        baked, origin32 = self._baked, origin.astype(np.float32)
        face: NDArray[np.int32] | None = None
        normal: Floats | None = None
        if "normals" in outputs:
            face, ranges, normal = baked.rays.hits(origin32, directions32, ranges, self._order)
        elif self._coloured or "segmentation" in outputs:
            face = baked.rays.hit_faces(origin32, directions32, ranges, self._order)
        else:
            baked.rays.shorten_ranges(origin32, directions32, ranges, self._order)
        colour: NDArray[np.uint32] | None = None
        segments: NDArray[np.uint8] | None = None
        if face is not None and self._coloured:
            colour = self._colours(origin, directions32, ranges, face)
        if face is not None and "segmentation" in outputs:
            segments = baked.segments.take(face, mode="wrap")
        looks = (colour, segments, normal)
        self._draw_meshes(origin, rotation, directions32, neighbours, ranges, looks)
        if not self._air.clear:
            self._look_through_air(origin, directions32, ranges, colour, segments)
        found: dict[str, NDArray[Any]] = {}
        if colour is not None:
            if "rgb" in outputs:
                found["rgb"] = np.empty((len(colour), 3), np.uint8)
                unpack_colours(colour, found["rgb"])
            if "grey" in outputs:
                found["grey"] = _grey(colour)
        if segments is not None:
            found["segmentation"] = segments
        if "depth" in outputs:
            found["depth"] = np.empty((scenes, pixels), np.float32)
            farthest = np.float32(self.conf.range_m)
            depths_along_axis(ranges.reshape(scenes, pixels), self._cosines, farthest, found["depth"])
        if normal is not None:
            found["normals"] = self._seen_normals(normal, directions, rotation)
        size = (scenes, self.conf.height, self.conf.width, -1)
        return {name: found[name].reshape(size) for name in outputs}

    def _colours(
        self, origin: Array, directions: Floats, ranges: Floats, face: NDArray[np.int32]
    ) -> NDArray[np.uint32]:
        """Packed colours (M * P,) of what rays `directions` (M * P, 3) from `origin` (M, 3) have met."""
        start = ((origin[:, :2] - self._corner) * self._texels).astype(np.float32)
        colour = np.empty(len(face), np.uint32)
        look_up_colours(
            directions, ranges, face, start, self._texels, self._last_texel, self._baked.ground.shape[1],
            self._ground, self._baked.ground_faces, self._faces, self._sky, colour,
        )  # fmt: skip
        if self._baked.texture is None:
            return colour
        # The pictures on things.
        ray = np.flatnonzero(self._pictured.take(face, mode="wrap"))
        if len(ray):
            along, scene = ranges[ray], ray // len(self._directions_b)
            points = origin[scene].astype(np.float32) + directions[ray] * along[:, None]
            own = face[ray] - self._baked.ground_faces
            colour[ray] = _packed(self._baked.textured_colours(own, points, along * self._pixel_rad))
        return colour

    def _draw_meshes(
        self,
        origin: Array,
        rotation: Array,
        directions: Floats,
        poses: Array,
        ranges: Floats,
        looks: tuple[NDArray[np.uint32] | None, NDArray[np.uint8] | None, Floats | None],
    ) -> None:
        """Put the bodies at `poses` (M, K, 7) into the pictures, where they are nearer than what is there."""
        colour, segments, normal = looks
        scenes, farthest = len(origin), self.conf.range_m
        view = (rotation @ self._tilt[:, 0], self._half_angle)
        rays = directions.reshape(scenes, -1, 3), self._order
        for mesh, columns in self._meshes:
            own = poses if len(self._meshes) == 1 else poses[:, columns]
            hit = mesh.hits(origin, *rays, own, farthest, view, ranges.reshape(scenes, -1))
            if not len(hit.ray):
                continue
            if normal is not None:
                normal[hit.ray] = hit.normal
            if colour is not None:
                colour[hit.ray] = _packed(mesh.colours(self._baked.light, hit.face, hit.normal))
            if segments is not None:
                segments[hit.ray] = mesh.segment

    def _look_through_air(
        self,
        origin: Array,
        directions: Floats,
        ranges: Floats,
        colour: NDArray[np.uint32] | None,
        segments: NDArray[np.uint8] | None,
    ) -> None:
        """Put haze and grass before what rays `directions` (M * P, 3) have met; arguments change in place."""
        foliage, start = self._air.foliage, origin.astype(np.float32)
        veil = None if foliage is None else foliage.transmission(start, directions, ranges)
        if colour is not None:
            nothing = ranges >= self.conf.range_m
            bare = np.ascontiguousarray(colour.view(np.uint8).reshape(-1, 4)[:, :3])
            colour[:] = _packed(self._air.attenuate(bare, ranges, nothing, veil, self._baked.light))
        if veil is not None:
            hidden = veil.range < ranges
            ranges[hidden] = veil.range[hidden]
            if segments is not None:
                segments[hidden] = Segment.VEGETATION

    def _seen_normals(self, normal: Floats, directions: Floats, rotation: Array) -> Floats:
        unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        unit = unit.reshape(directions.shape)
        away = np.einsum("mpi,mpi->mp", unit, directions) > 0.0
        unit = np.where(away[..., None], -unit, unit)
        seen: Floats = unit @ (rotation @ self._tilt).astype(np.float32)
        return seen


class Cameras(BatchedQueries[Camera]):
    """A `Camera` for each of M scenes, all of the same settings, in worlds and lights of their own.

    Poses are those of N = M * G robots, scene after scene.
    """

    def frames(self, position_w: Array, rotation: Array, neighbours: Array) -> dict[str, NDArray[Any]]:
        """As `Camera.frames`."""

        def frames(camera: Camera, *poses: Array) -> tuple[NDArray[Any], ...]:
            return tuple(camera.frames(*poses).values())

        outputs = self._items[0].conf.outputs
        return dict(zip(outputs, self._query(frames, position_w, rotation, neighbours), strict=True))


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Bytes (N, 3) as (N,) words: one look-up then fetches a whole colour."""
    words = np.zeros((len(colours), 4), np.uint8)
    words[:, :3] = colours
    return words.view(np.uint32).ravel()


def _grey(colour: NDArray[np.uint32]) -> NDArray[np.uint8]:
    # Luma: the weights on encoded values, as Pillow and OpenCV take it.
    weights = np.array([0.299, 0.587, 0.114, 0.0], np.float32)
    return (colour.view(np.uint8).reshape(-1, 4) @ weights + 0.5).astype(np.uint8)
