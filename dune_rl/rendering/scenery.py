"""Scenery: textured ground, and meshes with a colour per face."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField
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
class GroundTexture:
    """Linear RGB albedo (rows, columns, 3) of the ground, over the terrain's rectangle.

    Row 0 is at the lowest y, column 0 at the lowest x.
    """

    albedo: Floats


@dataclass(frozen=True, eq=False)
class Scenery:
    """Everything static and visible in a world."""

    terrain: HeightField
    ground: GroundTexture
    props: ColouredMesh


def join_meshes(shapes: list[ColouredMesh]) -> ColouredMesh:
    """Several meshes as one, in their order."""
    if not shapes:
        return ColouredMesh(
            np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)
        )
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    return ColouredMesh(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate(
            [shape.faces + start for shape, start in zip(shapes, starts, strict=True)], dtype=np.int32
        ),
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
