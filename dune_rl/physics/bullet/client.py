"""PyBullet clients, opened and used again, and meshes as a client takes them."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.arrays import Array
from dune_rl.physics.process import return_free_memory, suppress_stderr

with suppress_stderr():
    import pybullet

# The client of the scene that was closed last. Where worlds differ between episodes, scenes are closed and
# built in turn: to reset a client takes 3 ms, to open one 60 ms.
_spare: list[int] = []

# Meshes with as many faces are filled into lists of their own, which the next scene of the same world finds
# filled; and what PyBullet needed on the way to them is given back.
_LARGE_FACES = 20_000


class _MeshLists:
    """A mesh as lists of vertices and of their indices.

    PyBullet never releases the lists that it is given, nor those in them: 200 bytes of each triangle. So all
    meshes share one set of them.
    """

    def __init__(self) -> None:
        self.vertices: list[list[float]] = []
        self.indices: list[int] = []
        self._rows: list[list[float]] = []
        self._filled: tuple[Array, NDArray[np.int32]] | None = None

    def fill(self, vertices: Array, faces: NDArray[np.int32]) -> None:
        """Take the values of vertices (V, 3) [m] and faces (F, 3), unless these very arrays were the last."""
        if self._filled is not None and self._filled[0] is vertices and self._filled[1] is faces:
            return
        self._rows.extend([0.0, 0.0, 0.0] for _ in range(len(vertices) - len(self._rows)))
        for row, vertex in zip(self._rows, vertices.tolist(), strict=False):
            row[:] = vertex
        self.vertices[:] = self._rows[: len(vertices)]
        self.indices[:] = faces.ravel().tolist()
        self._filled = vertices, faces

    def clear(self) -> bool:
        """Drop the values; returns whether there were any."""
        if self._filled is None:
            return False
        self._filled = None
        self.vertices.clear()
        self.indices.clear()
        return True


_small, _large = _MeshLists(), _MeshLists()


def create_mesh_shape(vertices: Array, faces: NDArray[np.int32], client: int) -> int:
    """Handle of a concave collision shape of vertices (V, 3) [m] and faces (F, 3); negative if refused.

    The arrays must not change until `release_mesh_lists`.
    """
    is_large = len(faces) >= _LARGE_FACES
    lists = _large if is_large else _small
    lists.fill(vertices, faces)
    shape: int = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        vertices=lists.vertices,
        indices=lists.indices,
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    if is_large:
        return_free_memory()
    else:
        lists.clear()
    return shape


def release_mesh_lists() -> None:
    """Drop the copy of the last large mesh; to be called when no more scenes are built at present."""
    if _large.clear():
        return_free_memory()


def open_client() -> int:
    """A client in DIRECT mode without bodies; raises PhysicsError if PyBullet opens no more."""
    while _spare:
        client = _spare.pop()
        if pybullet.isConnected(client):
            return client
    client = int(pybullet.connect(pybullet.DIRECT))
    if client < 0:
        raise PhysicsError("PyBullet opened no further client in this process; use fewer scenes")
    return client


def release_client(client: int) -> None:
    """Remove all that a client holds; close it unless it is kept for the next scene."""
    if client in _spare or not pybullet.isConnected(client):
        return
    if not _spare:
        pybullet.resetSimulation(physicsClientId=client)
        _spare.append(client)
        return
    pybullet.disconnect(client)
    return_free_memory()
