"""Scenery: textured ground, meshes with a colour per face, and the surface properties that beams measure."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import BatchedQueries
from dune_rl.rendering.mesh_texture import MeshTexture, join_textures


class Segment(IntEnum):
    """Semantic classes: the values of segmentations of pixels and beams."""

    SKY = 0
    GROUND = 1
    DECK = 2
    OBSTACLE = 3
    WATER = 4
    VEGETATION = 5
    ACTOR = 6
    ROBOT = 7


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """A mesh: `vertices` (V, 3) [m], `faces` (F, 3), `albedo` (F, 3) in linear RGB, `segments` (F,).

    On faces with a `texture`, `albedo` is its mean.
    """

    vertices: Array
    faces: NDArray[np.int32]
    albedo: Floats
    segments: NDArray[np.uint8]
    texture: MeshTexture | None = None


@dataclass(frozen=True, eq=False)
class Scenery:
    """Everything static and visible in a world.

    `ground` (rows, columns, 3) is the linear RGB albedo of the ground over the terrain's rectangle; row 0 is
    at the lowest y, column 0 at the lowest x.
    """

    terrain: HeightField
    ground: Floats
    props: ColouredMesh


def join_meshes(shapes: list[ColouredMesh]) -> ColouredMesh:
    """Several meshes as one, in their order."""
    if not shapes:
        nothing = np.zeros((0, 3))
        return ColouredMesh(
            nothing, nothing.astype(np.int32), nothing.astype(np.float32), np.zeros(0, np.uint8)
        )
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    faces = [shape.faces + start for shape, start in zip(shapes, starts, strict=True)]
    return ColouredMesh(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate(faces, dtype=np.int32),
        np.concatenate([shape.albedo for shape in shapes]),
        np.concatenate([shape.segments for shape in shapes]),
        join_textures([shape.texture for shape in shapes], [len(shape.faces) for shape in shapes]),
    )


def subdivide_mesh(shape: ColouredMesh, longest_m: float) -> ColouredMesh:
    """The same surface with edges of at most `longest_m`, so that baked light can vary over it."""
    if not len(shape.faces):
        return shape
    # Only now: it takes half a second to load, and those who read settings need none of it.
    import trimesh

    vertices, faces, origin = trimesh.remesh.subdivide_to_size(
        shape.vertices, shape.faces, longest_m, return_index=True
    )
    return ColouredMesh(
        np.asarray(vertices),
        np.asarray(faces, np.int32),
        shape.albedo[origin],
        shape.segments[origin],
        None if shape.texture is None else shape.texture.select_faces(origin),
    )


# Weights of linear red, green and blue (ITU-R BT.709).
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True, eq=False)
class BeamSurface:
    """Segments (F + 1,) and albedo luminances (F + 1,) in [0, 1] of the F faces of a mesh.

    The last entry is for a ray without a hit, whose face is -1.
    """

    segments: NDArray[np.uint8]
    luminance: Floats

    def look_up(self, face: NDArray[np.int32]) -> tuple[NDArray[np.uint8], Floats]:
        """Segments (N,) and luminances (N,) of faces (N,)."""
        return self.segments.take(face, mode="wrap"), self.luminance.take(face, mode="wrap")

    def select_scenes(self, scenes: NDArray[np.int64]) -> Self:
        """Itself, since all scenes share it; see `BatchedBeamSurfaces`."""
        return self

    @classmethod
    def from_faces(cls, segments: NDArray[np.uint8], albedo: Floats) -> Self:
        """The surface of faces with `segments` (F,) and `albedo` (F, 3) in linear RGB."""
        return cls(np.append(segments, np.uint8(Segment.SKY)), np.append(luminance(albedo), np.float32(0.0)))


class BatchedBeamSurfaces(BatchedQueries[BeamSurface]):
    """A `BeamSurface` for each of M scenes; faces are scene-major."""

    def look_up(self, face: NDArray[np.int32]) -> tuple[NDArray[np.uint8], Floats]:
        """As `BeamSurface.look_up`."""
        segments, brightness = self._query(BeamSurface.look_up, face)
        return segments, brightness


def luminance(albedo: Floats) -> Floats:
    """Luminance (...) of linear RGB (..., 3)."""
    return albedo @ _WEIGHTS
