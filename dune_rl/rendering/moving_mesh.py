"""Coloured meshes at any pose: those of moving agents, many copies at once, and single ones for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.posed_rays import PosedScenes
from dune_rl.geometry.rays import Hits, RayScene
from dune_rl.rendering.baked_scenery import to_srgb_bytes
from dune_rl.rendering.light import Light
from dune_rl.rendering.scenery import ColouredMesh, Segment


class RayMesh:
    """A `ColouredMesh` with its ray scene and bounding sphere, in its own frame."""

    def __init__(self, shape: ColouredMesh) -> None:
        self.shape = shape
        self.rays = RayScene(shape.vertices, shape.faces)
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        self.centre = (low + high) / 2
        self.radius_m = float(np.linalg.norm(shape.vertices - self.centre, axis=1).max())


class MovingMesh(PosedScenes):
    """A closed mesh that may be anywhere and lean; F of them, in `frames`, where its parts move.

    `shape` is a rigid mesh, or the meshes of the frames in their order. Frames are the phases of a motion
    that repeats, such as a stride or the turn of a propeller. A pose (x, y, z [m], yaw, roll, pitch [rad],
    frame) has the number of the frame that is seen there. `albedo` (faces of all frames, 3) is in linear RGB.
    """

    def __init__(
        self, shape: ColouredMesh | Sequence[ColouredMesh], segment: Segment = Segment.ACTOR
    ) -> None:
        shapes = (shape,) if isinstance(shape, ColouredMesh) else tuple(shape)
        self.frames = tuple(RayMesh(each) for each in shapes)
        self.segment = segment
        self.albedo = np.concatenate([each.albedo for each in shapes])
        # Round a centre on the yaw axis, which yaw does not move.
        corners = np.concatenate([each.vertices for each in shapes])
        height = float(corners[:, 2].min() + corners[:, 2].max()) / 2
        radius = float(np.linalg.norm(corners - [0.0, 0.0, height], axis=1).max())
        super().__init__([frame.rays for frame in self.frames], (height, radius))

    def frame(self, number: float) -> RayMesh:
        """The mesh of a frame, by its number in a pose."""
        return self.frames[int(number) % len(self.frames)]

    def colours(self, light: Light, face: NDArray[np.int32], normal: Floats) -> NDArray[np.uint8]:
        """SRGB bytes (R, 3) of faces (R,), as in `PosedHits`, with unit world `normal` (R, 3), unshadowed."""
        full = np.ones(len(face), np.float32)
        return to_srgb_bytes(light.shade(self.albedo[face], normal, full, full))


@dataclass(frozen=True)
class PosedMesh:
    """A mesh at `position` (3,) [m] with `rotation` (3, 3) to the world frame."""

    solid: RayMesh
    position: Array
    rotation: Array

    @property
    def shape(self) -> ColouredMesh:
        """The coloured mesh, in its own frame."""
        return self.solid.shape

    @cached_property
    def centre(self) -> Array:
        """Centre of the bounding sphere, world frame (3,)."""
        return self.position + self.rotation @ self.solid.centre

    def candidate_rays(self, eye: Floats, directions: Floats) -> NDArray[np.int64]:
        """Indices of the rays along `directions` (N, 3) from `eye` (3,) that hit the bounding sphere."""
        offset = (self.centre - eye).astype(np.float32)
        distance = float(np.linalg.norm(offset))
        if distance <= self.solid.radius_m:
            return np.arange(len(directions))
        cosine = np.sqrt(1.0 - (self.solid.radius_m / distance) ** 2)
        return np.flatnonzero(directions @ (offset / np.float32(distance)) >= cosine)

    def shadow_candidates(self, points: Floats, to_sun: Floats) -> NDArray[np.int64]:
        """Indices of the points (N, 3) whose ray to the sun hits the bounding sphere."""
        offset = self.centre.astype(np.float32) - points
        along = offset @ to_sun
        aside = np.einsum("ij,ij->i", offset, offset) - along * along
        radius = self.solid.radius_m
        return np.flatnonzero((aside <= radius * radius) & (along >= -radius))

    def hits(self, origins: Floats, directions: Floats, ranges: Floats) -> Hits:
        """First hits of world rays (R, 3) within `ranges` (R,), with normals in the world frame."""
        local, turned = self._to_own_frame(origins, directions)
        face, ranges, normal = self.solid.rays.hits(local, turned, ranges.copy())
        return Hits(face, ranges, normal @ self.rotation.T.astype(np.float32))

    def any_hit(self, origins: Floats, directions: Floats) -> Flags:
        """Whether each of the world rays (R, 3) hits the mesh, (R,)."""
        local, turned = self._to_own_frame(origins, directions)
        return self.solid.rays.any_hit(local, turned)

    def _to_own_frame(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        turn = self.rotation.astype(np.float32)
        return (origins - self.position.astype(np.float32)) @ turn, directions @ turn
