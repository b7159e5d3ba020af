"""Coloured meshes at any pose: those of moving agents, many copies at once, and single ones for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.posed_rays import PosedScenes
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.baked_scenery import to_srgb_bytes
from dune_rl.rendering.light import Light
from dune_rl.rendering.scenery import ColouredMesh, Segment


class RayMesh:
    """A `ColouredMesh` with its ray scene."""

    def __init__(self, shape: ColouredMesh) -> None:
        self.shape = shape
        self.rays = RayScene(shape.vertices, shape.faces)


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


class PosedBodies:
    """Several posed meshes as one, in the world frame, so that rays meet all of them at once.

    `vertices` (V, 3) [m], `faces` (F, 3) and `albedo` (F, 3), in linear RGB, are of all of them.
    """

    def __init__(self, bodies: Sequence[PosedMesh]) -> None:
        shapes = [body.shape for body in bodies]
        vertices = [body.position + body.shape.vertices @ body.rotation.T for body in bodies]
        starts = np.cumsum([0, *(len(each) for each in vertices[:-1])])
        faces = [shape.faces + start for shape, start in zip(shapes, starts, strict=True)]
        self.vertices, self.faces = np.concatenate(vertices), np.concatenate(faces, dtype=np.int32)
        self.rays = RayScene(self.vertices, self.faces, short_lived=True)
        self.albedo = np.concatenate([shape.albedo for shape in shapes])
