"""Ray packets at copies of triangle scenes that stand, lean and move anywhere."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.embree import (
    ARGUMENTS,
    DIRECTION,
    FACE,
    GEOMETRY,
    NONE,
    NORMAL,
    ROWS,
    TFAR,
    WIDTH,
    intersect16,
    new_packet,
)
from dune_rl.geometry.frames import POSE_COLUMNS
from dune_rl.geometry.rays import RayScene, counted


class PosedHits(NamedTuple):
    """What H rays have hit of copies of scenes.

    `ray` (H,) are their numbers through all rows, in rising order, `face` (H,) the faces, counted through all
    frames, and `normal` (H, 3) unit normals in the world frame.
    """

    ray: NDArray[np.int64]
    face: NDArray[np.int32]
    normal: Floats


_NO_HITS = PosedHits(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros((0, 3), np.float32))


class PosedScenes:
    """F triangle scenes, the frames of a shape that moves, whose copies may be anywhere and lean.

    A sphere round (0, 0, `sphere[0]`) [m] of radius `sphere[1]`, in the frame of the scenes, holds them all.

    Rays have `origins` (N, 3) and unit `directions` (N, P, 3); those of row n meet the K copies at `poses`
    (N, K, 7): x, y, z [m], yaw, roll and pitch [rad], and the number of its frame, counted modulo F. Copies
    roll first, then pitch (nose down), then turn. Rays are traced only if they pass the sphere.
    """

    def __init__(self, frames: Sequence[RayScene], sphere: tuple[float, float]) -> None:
        # The library must not free the scenes.
        self._scenes = tuple(frames)
        self._handles = np.array([frame.handle for frame in frames], np.intp)
        self._first_faces = np.cumsum([0, *(frame.num_faces for frame in frames[:-1])])
        self._sphere = sphere

    def shorten_ranges(
        self,
        origins: Array,
        directions: NDArray[np.floating],
        poses: Array,
        farthest: float,
        ranges: Floats,
    ) -> None:
        """Shorten `ranges` (N, P), at most `farthest`, in place to the first hits of the copies."""
        rays, whole = (
            (origins, directions, counted(directions.shape[1])),
            (np.zeros((len(origins), 3)), np.inf),
        )
        self._cast(rays, poses, farthest, whole, ranges, _NO_HITS)

    def hits(
        self,
        origins: Array,
        directions: NDArray[np.floating],
        order: NDArray[np.int64],
        poses: Array,
        farthest: float,
        view: tuple[Array, float],
        ranges: Floats,
    ) -> PosedHits:
        """As `shorten_ranges`, and what the rays that a copy shortens have hit.

        The rays of a row lie within an angle [rad] of its axis: `view` has axes (N, 3) and the angle. They
        are traced in the `order` (P,) of their numbers.
        """
        size = ranges.size
        found = PosedHits(np.empty(size, np.int64), np.empty(size, np.int32), np.empty((size, 3), np.float32))
        count = self._cast((origins, directions, order), poses, farthest, view, ranges, found)
        return PosedHits(found.ray[:count], found.face[:count], found.normal[:count])

    def _cast(
        self,
        rays: Any,
        poses: Array,
        farthest: float,
        view: tuple[Array, float],
        ranges: Floats,
        found: PosedHits,
    ) -> int:
        # Compiled code would read beyond the array's end.
        if poses.shape[-1] != POSE_COLUMNS:
            raise ValueError(
                f"poses have {POSE_COLUMNS} columns (x, y, z, yaw, roll, pitch, frame), got {poses.shape[-1]}"
            )
        poses = np.ascontiguousarray(poses, np.float64)
        scenes, bounds = (self._handles, self._first_faces), (*self._sphere, farthest)
        copies = poses, np.cos(poses[..., 3]), np.sin(poses[..., 3])
        return _cast_at_copies(scenes, ARGUMENTS, rays, copies, bounds, view, ranges, tuple(found))


@compile_function
def _turn(pose: Any, cos: float, sin: float, rotation: Any) -> None:
    """Rotation (3, 3) from the frame of a copy at `pose` (7) to the world's; of its yaw, cosine and sine."""
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = cos, -sin, 0.0
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = sin, cos, 0.0
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 0.0, 0.0, 1.0
    roll, pitch = pose[4], pose[5]
    if roll == 0.0 and pitch == 0.0:
        return
    cos_roll, sin_roll, cos_pitch, sin_pitch = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    for axis in range(2):
        ahead, aside = rotation[axis, 0], rotation[axis, 1]
        rotation[axis, 0] = ahead * cos_pitch
        rotation[axis, 1] = ahead * sin_pitch * sin_roll + aside * cos_roll
        rotation[axis, 2] = ahead * sin_pitch * cos_roll - aside * sin_roll
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = -sin_pitch, cos_pitch * sin_roll, cos_pitch * cos_roll


@compile_function
def _store_normal(local: Any, rotation: Any, found: Any) -> None:
    """The unit normal `found` (3,), world frame, of a normal (3,) of any length in the frame of a copy."""
    length = np.sqrt(local[0] * local[0] + local[1] * local[1] + local[2] * local[2])
    length = max(length, np.float32(1e-12))
    x, y, z = local[0] / length, local[1] / length, local[2] / length
    for axis in range(3):
        found[axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z


@compile_function
def _cast_at_copies(
    scenes: Any, arguments: int, rays: Any, copies: Any, bounds: Any, view: Any, ranges: Any, found: Any
) -> int:
    handles, first_faces = scenes
    origins, directions, order = rays
    poses, cosines, sines = copies
    height, radius, farthest = bounds
    axes, half_angle = view
    hit_rays, hit_faces, hit_normals = found
    words, numbers = new_packet()
    mask, packet = words[ROWS:].ctypes.data, words.ctypes.data
    loaded, rotation = np.empty(WIDTH, np.int64), np.empty((3, 3))
    radius = radius * (1.0 + 1e-6) + 1e-6
    count_rays, hits = directions.shape[1], 0
    records = len(hit_rays) > 0
    # What the rays of a row have hit: face (-1 for none) and normal.
    faces = np.empty(count_rays if records else 0, np.int32)
    normals = np.empty((len(faces), 3), np.float32)
    for row in range(len(origins)):
        is_near = False
        for copy in range(poses.shape[1]):
            pose = poses[row, copy]
            dx, dy, dz = origins[row, 0] - pose[0], origins[row, 1] - pose[1], origins[row, 2] - pose[2]
            _turn(pose, cosines[row, copy], sines[row, copy], rotation)
            # From the origin to the centre of the sphere.
            ahead_x, ahead_y = height * rotation[0, 2] - dx, height * rotation[1, 2] - dy
            ahead_z = height * rotation[2, 2] - dz
            away = ahead_x * ahead_x + ahead_y * ahead_y + ahead_z * ahead_z
            if away > (farthest + radius) ** 2:
                continue
            if away > radius * radius and half_angle < np.pi:
                distance = np.sqrt(away)
                ahead = ahead_z * axes[row, 2] + ahead_x * axes[row, 0] + ahead_y * axes[row, 1]
                aside = np.arccos(min(max(ahead / distance, -1.0), 1.0))
                if aside - np.arcsin(radius / distance) >= half_angle + 1e-6:
                    continue
            if records and not is_near:
                is_near = True
                for ray in range(count_rays):
                    faces[ray] = -1
            frame = np.int64(pose[6]) % len(handles)
            for axis in range(3):
                start = np.float32(rotation[0, axis] * dx + rotation[1, axis] * dy + rotation[2, axis] * dz)
                for k in range(WIDTH):
                    numbers[axis, k] = start
            # From outside, a ray that passes the sphere goes at least as far along as its tangent.
            tangent = (away - radius * radius) * (1.0 - 1e-6)
            count = 0
            for place in range(count_rays + 1):
                if place < count_rays:
                    ray = order[place]
                    x, y, z = directions[row, ray, 0], directions[row, ray, 1], directions[row, ray, 2]
                    along = ahead_z * z + ahead_x * x + ahead_y * y
                    if tangent > 0.0 and (along <= 0.0 or along * along < tangent):
                        continue
                    for axis in range(3):
                        numbers[DIRECTION + axis, count] = np.float32(
                            rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
                        )
                    loaded[count] = ray
                    count += 1
                if count == WIDTH or (place == count_rays and count > 0):
                    for k in range(WIDTH):
                        words[ROWS, k] = NONE if k < count else np.uint32(0)
                    for k in range(count):
                        numbers[TFAR, k] = ranges[row, loaded[k]]
                        words[GEOMETRY, k] = NONE
                    intersect16(mask, handles[frame], packet, arguments)
                    for k in range(count):
                        ray = loaded[k]
                        ranges[row, ray] = numbers[TFAR, k]
                        if records and words[GEOMETRY, k] != NONE:
                            faces[ray] = np.int32(words[FACE, k] + first_faces[frame])
                            _store_normal(numbers[NORMAL : NORMAL + 3, k], rotation, normals[ray])
                    count = 0
        if is_near:
            for ray in range(count_rays):
                if faces[ray] >= 0:
                    hit_rays[hits] = row * count_rays + ray
                    hit_faces[hits] = faces[ray]
                    for axis in range(3):
                        hit_normals[hits, axis] = normals[ray, axis]
                    hits += 1
    return hits
