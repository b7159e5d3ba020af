"""Large meshes in pieces that an engine takes."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


def mesh_pieces(
    vertices: Array, faces: Faces, most_vertices: int, most_faces: int
) -> Iterator[tuple[Array, Faces]]:
    """The mesh in pieces within both bounds, side by side along its length; as it is where it keeps to them.

    Every triangle is in one piece, as it was: pieces share the places of the vertices along their seams.
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
        # Their seams may bring more vertices than the bound: then once more.
        yield from mesh_pieces(vertices[used], piece, most_vertices, most_faces)
