"""Meshes with colours and pictures, in parts of one material each, as files of meshes have them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Bytes, Floats
from dune_rl.rendering.light import linear_to_srgb
from dune_rl.rendering.mesh_texture import MeshTexture
from dune_rl.rendering.scenery import ColouredMesh
from dune_rl.worlds.world import Prop

# Side of a colour's square in a palette [px], so that pictures at a distance do not mix it with others.
_SQUARE = 4
Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PaintedPart:
    """Faces (F, 3) with a `picture` (rows, columns, 3) of sRGB bytes, and `uv` (F, 3, 2) of their corners.

    Without a picture they have one `colour` (sRGB). `u` and `v` run from 0 at the picture's lower left to 1.
    """

    faces: NDArray[np.int32]
    colour: Colour = (1.0, 1.0, 1.0)
    picture: Bytes | None = None
    uv: Array | None = None


@dataclass(frozen=True, eq=False)
class PaintedMesh:
    """`vertices` (V, 3) [m] and the parts that use them; `normals` (V, 3) make it look smooth."""

    vertices: Array
    parts: tuple[PaintedPart, ...]
    normals: Array | None = None

    @property
    def colour(self) -> Colour | None:
        """The colour (sRGB) of all of it; None if it has several, or a picture."""
        (first, *others) = self.parts
        return None if others or first.picture is not None else first.colour


def paint_mesh(
    vertices: Array, faces: NDArray[np.int32], colours: Floats, texture: MeshTexture | None = None
) -> PaintedMesh:
    """The mesh with sRGB `colours` (F, 3) of its faces; those with a picture in `texture` have that."""
    parts, plain = [], np.ones(len(faces), bool)
    if texture is not None:
        for number, picture in enumerate(texture.pictures):
            chosen = texture.picture == number
            if chosen.any():
                uv = texture.uv(chosen, vertices[faces[chosen]])
                parts.append(PaintedPart(faces[chosen], picture=picture, uv=uv))
                plain &= ~chosen
    if plain.any():
        parts.append(_paint_faces(faces[plain], np.broadcast_to(colours, (len(faces), 3))[plain]))
    return PaintedMesh(np.asarray(vertices, np.float64), tuple(parts))


def _paint_faces(faces: NDArray[np.int32], colours: Floats) -> PaintedPart:
    """Faces with one colour, or with a palette of theirs as a picture."""
    bytes_ = np.round(np.clip(colours, 0.0, 1.0) * 255.0).astype(np.uint8)
    palette, index = np.unique(bytes_, axis=0, return_inverse=True)
    if len(palette) == 1:
        red, green, blue = colours[0].astype(np.float64).round(6).tolist()
        return PaintedPart(faces, (red, green, blue))
    # Sides of powers of two, which nothing has to resize.
    side = 1 << int(np.ceil(np.log2(np.sqrt(len(palette)))))
    squares = np.zeros((side * side, 3), np.uint8)
    squares[: len(palette)] = palette
    picture = squares.reshape(side, side, 3).repeat(_SQUARE, axis=0).repeat(_SQUARE, axis=1)
    row, column = np.divmod(index.reshape(-1), side)
    centre = np.stack([(column + 0.5) / side, 1.0 - (row + 0.5) / side], axis=1)
    return PaintedPart(faces, picture=picture, uv=np.repeat(centre[:, None], 3, axis=1))


def paint_prop(prop: Prop, origin: Array) -> PaintedMesh:
    """A prop relative to `origin` (3,)."""
    colours = np.array(prop.colour, np.float32) if prop.face_colours is None else prop.face_colours
    texture = prop.texture
    if texture is not None:
        to_origin = np.eye(4)
        to_origin[:3, 3] = -origin
        texture = texture.transform(to_origin)
    return paint_mesh(prop.vertices - origin, prop.faces, colours, texture)


def paint_scenery(mesh: ColouredMesh) -> PaintedMesh:
    """The mesh of a body in its own frame."""
    return paint_mesh(mesh.vertices, mesh.faces, linear_to_srgb(mesh.albedo), mesh.texture)


def face_normals(mesh: PaintedMesh, part: PaintedPart) -> Array:
    """Unit normals (F, 3) of a part's faces."""
    corners = mesh.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit: Array = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return unit


def corner_rows(mesh: PaintedMesh, part: PaintedPart) -> tuple[Array, Array, Array]:
    """Positions (3 F, 3), normals (3 F, 3) and uv (3 F, 2), 0 without a picture, of the corners of a part."""
    index = part.faces.reshape(-1)
    normals = np.repeat(face_normals(mesh, part), 3, axis=0) if mesh.normals is None else mesh.normals[index]
    uv = np.zeros((len(index), 2)) if part.uv is None else part.uv.reshape(-1, 2)
    return mesh.vertices[index], normals, uv
