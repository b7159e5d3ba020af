"""Meshes of moving agents: their ray scenes, in the mesh's own frame, serve all agents of a shape."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.embree.posed_scenes import PosedHits, PosedScenes
from dune_rl.rendering.baked_scenery import to_srgb_bytes
from dune_rl.rendering.light import Light
from dune_rl.rendering.posed_mesh import RayMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment


class MovingMesh:
    """A closed mesh that may be anywhere and lean; F of them, in `frames`, where its parts move.

    Frames are the phases of a motion that repeats, such as a stride or the turn of a propeller. A pose
    (x, y, z [m], yaw, roll, pitch [rad], frame) has the number of the frame that is seen there.
    `albedo` (faces of all frames, 3) is in linear RGB.
    """

    def __init__(
        self, shape: ColouredMesh | Sequence[ColouredMesh], segment: Segment = Segment.ACTOR
    ) -> None:
        """`shape` is a rigid mesh, or the meshes of the frames in their order."""
        shapes = (shape,) if isinstance(shape, ColouredMesh) else tuple(shape)
        self.frames = tuple(RayMesh(each) for each in shapes)
        self.segment = segment
        self.albedo = np.concatenate([each.albedo for each in shapes])
        # Round a centre on the yaw axis, which yaw does not move.
        corners = np.concatenate([each.vertices for each in shapes])
        height = float(corners[:, 2].min() + corners[:, 2].max()) / 2
        radius = float(np.linalg.norm(corners - [0.0, 0.0, height], axis=1).max())
        self._copies = PosedScenes([frame.rays.triangles for frame in self.frames], (height, radius))

    def frame(self, number: float) -> RayMesh:
        """The mesh of a frame, by its number in a pose."""
        return self.frames[int(number) % len(self.frames)]

    def shorten_ranges(
        self, origins: Array, directions: NDArray[np.floating], poses: Array, farthest: float, ranges: Floats
    ) -> None:
        """Shorten `ranges` (N, P), at most `farthest`, in place to the first hits of meshes at `poses`.

        Rays have `origins` (N, 3) and unit `directions` (N, P, 3), world frame; those of row n meet the
        meshes at `poses` (N, K, 7).
        """
        self._copies.shorten_ranges(origins, directions, poses, farthest, ranges)

    def first_hits(
        self,
        origins: Array,
        directions: Floats,
        order: NDArray[np.int64],
        poses: Array,
        farthest: float,
        view: tuple[Array, float],
        ranges: Floats,
    ) -> PosedHits:
        """As `shorten_ranges`, and what the rays that are shortened have hit.

        `view` and `order` are as for `PosedScenes.hits`.
        """
        return self._copies.hits(origins, directions, order, poses, farthest, view, ranges)

    def colours(self, light: Light, face: NDArray[np.int32], normal: Floats) -> NDArray[np.uint8]:
        """SRGB bytes (R, 3) of faces (R,), as in `PosedHits`, with unit world `normal` (R, 3), unshadowed."""
        full = np.ones(len(face), np.float32)
        return to_srgb_bytes(light.shade(self.albedo[face], normal, full, full))
