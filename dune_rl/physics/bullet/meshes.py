"""Meshes as PyBullet takes them."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.stderr import suppress_stderr

with suppress_stderr():
    import pybullet

# PyBullet never releases the lists that it is given, nor those in them: 200 bytes of each triangle. So there
# is one set of them, which all meshes share.
_rows: list[list[float]] = []
_vertices: list[list[float]] = []
_indices: list[int] = []


def create_mesh_shape(vertices: NDArray[np.float64], faces: NDArray[np.int32], client: int) -> int:
    """Handle of a concave collision shape of vertices (V, 3) [m] and faces (F, 3); negative if refused."""
    _rows.extend([0.0, 0.0, 0.0] for _ in range(len(vertices) - len(_rows)))
    for row, vertex in zip(_rows, vertices.tolist(), strict=False):
        row[:] = vertex
    _vertices[:] = _rows[: len(vertices)]
    _indices[:] = faces.ravel().tolist()
    shape: int = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        vertices=_vertices,
        indices=_indices,
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    _indices.clear()
    return shape
