"""Ray casting against triangle meshes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.embree import TriangleScene

Floats = NDArray[np.float32]

_NO_FACES, _NO_NORMALS = np.zeros(0, np.int32), np.zeros((0, 3), np.float32)


class Hits(NamedTuple):
    """What rays met first: the face's index (N,), -1 for none; the range (N,); its normal, of any length."""

    face: NDArray[np.int32]
    range: Floats
    normal: Floats


class RayScene:
    """A static set of triangles that rays are cast against.

    `vertices` (V, 3) [m] and `faces` (F, 3) are copied. Rays have float32
    `origins` (S, 3) and `directions` (N, 3), C-contiguous: each origin belongs
    to N / S rays in a row. Directions of unit length make ranges metres.
    Sixteen rays in a row are cast together, which is fastest where they go much
    the same way, as a camera's do.
    """

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self._triangles = TriangleScene(vertices, faces)

    def select_scenes(self, scenes: NDArray[np.int64]) -> "RayScene":
        """Itself: it is the same for all scenes; see `RayScenes`."""
        return self

    def shorten_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> None:
        """Shorten `ranges` (N,) in place to the first hit.

        A ray whose range is already shorter than its first hit keeps it, so
        several scenes can be asked in turn.
        """
        self._triangles.intersect(origins, directions, ranges, _NO_FACES, _NO_NORMALS)

    def hits(self, origins: Floats, directions: Floats, ranges: Floats) -> Hits:
        """First hits of rays as in `shorten_ranges`; `ranges` (N,) are shortened too."""
        faces = np.empty(len(directions), np.int32)
        normals = np.empty((len(directions), 3), np.float32)
        self._triangles.intersect(origins, directions, ranges, faces, normals)
        return Hits(faces, ranges, normals)

    def first_hit(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], range_m: float
    ) -> tuple[Floats, Floats]:
        """Range to the first hit (N,), `range_m` for none, and its normal there (N, 3), of any length."""
        ranges = np.full(len(directions), range_m, np.float32)
        found = self.hits(
            np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32), ranges
        )
        return found.range, found.normal

    def any_hit(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """Whether anything at all lies on each ray, (N,)."""
        return self._triangles.occluded(origins, directions)
