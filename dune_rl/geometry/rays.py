"""Ray casting against triangle meshes, on Embree."""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

_device: EmbreeDevice | None = None


def _shared_device() -> EmbreeDevice:
    # One device serves every scene of a process: each further one costs threads and memory.
    global _device
    if _device is None:
        _device = EmbreeDevice()
    return _device


class RayScene:
    """A static set of triangles that rays are cast against.

    `vertices` (V, 3) [m] and `faces` (F, 3) are copied into Embree.
    """

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self._scene = EmbreeScene(_shared_device())
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
        )

    def shorten(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        ranges: NDArray[np.float32],
    ) -> None:
        """Shorten `ranges` (N,) in place to the first hit.

        `origins` and `directions` are (N, 3), C-contiguous; directions of unit
        length make the ranges metres. A ray whose range is already shorter
        than its first hit keeps it, so several scenes can be asked in turn.
        """
        # Of the queries without further output only this one writes the ranges back.
        self._scene.run(origins, directions, dists=ranges, query="DISTANCE")

    def hits(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        ranges: NDArray[np.float32],
    ) -> "Hits":
        """First hits of rays as in `shorten`; `ranges` (N,) are shortened too."""
        found = self._scene.run(origins, directions, dists=ranges, output=True)
        ranges[:] = found["tfar"]
        return Hits(found["primID"], ranges, found["Ng"])

    def first_hit(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], range_m: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Range to the first hit (N,), `range_m` for none, and its normal there (N, 3), of any length."""
        ranges = np.full(len(origins), range_m, np.float32)
        found = self.hits(
            np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32), ranges
        )
        return found.range, found.normal

    def blocked(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether anything at all lies on each ray, (N,)."""
        missed: NDArray[np.bool_] = self._scene.run(origins, directions, query="OCCLUDED") < 0
        return ~missed


class Hits(NamedTuple):
    """What rays met first: the face's index (N,), -1 for none; the range (N,); its normal, of any length."""

    face: NDArray[np.int32]
    range: NDArray[np.float32]
    normal: NDArray[np.float32]
