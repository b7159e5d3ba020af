"""Splitting of meshes that are larger than an engine accepts."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array

Faces = NDArray[np.int32]


def mesh_pieces(
    vertices: Array, faces: Faces, most_vertices: int, most_faces: int
) -> Iterator[tuple[Array, Faces]]:
    """Split a mesh into pieces within both limits, along its longest axis; a mesh within them stays whole.

    Every triangle is in exactly one piece, unchanged; pieces repeat the vertices along their seams.
    """
    if len(vertices) <= most_vertices and len(faces) <= most_faces:
        yield vertices, faces
        return
    count = max(2, -(-len(faces) // most_faces), -(-len(vertices) // most_vertices))
    centres = vertices[faces].mean(axis=1)
    order = np.argsort(centres[:, int(np.ptp(centres, axis=0).argmax())], kind="stable")
    for chosen in np.array_split(order, count):
        used, index = np.unique(faces[chosen], return_inverse=True)
        piece = index.reshape(-1, 3).astype(np.int32)
        # Repeated vertices along the seams may exceed the limit: split again.
        yield from mesh_pieces(vertices[used], piece, most_vertices, most_faces)
