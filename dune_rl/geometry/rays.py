"""Ray casting against triangle meshes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.embree.triangle_scene import TriangleScene

Order = NDArray[np.int64] | None

_NO_FACES, _NO_NORMALS = np.zeros(0, np.int32), np.zeros((0, 3), np.float32)


class Hits(NamedTuple):
    """First hits of N rays: face indices (N,), -1 for a miss; ranges (N,); unnormalised normals (N, 3)."""

    face: NDArray[np.int32]
    range: Floats
    normal: Floats


class RayScene:
    """A static set of triangles to cast rays against.

    `vertices` (V, 3) [m] and `faces` (F, 3) are copied, into `triangles`. Rays have C-contiguous
    float32 `origins` (S, 3) and `directions` (N, 3): each origin serves N / S
    consecutive rays. Ranges are metres if directions have unit length.
    Rays are cast in packets of 16 consecutive ones, which is fastest where
    their directions are similar. `order` (N / S,) has the numbers of the rays of each origin in
    another order, such as square tiles of a picture: results are the same, sooner.
    """

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self.triangles = TriangleScene(vertices, faces)

    def select_scenes(self, scenes: NDArray[np.int64]) -> "RayScene":
        """Itself, since all scenes share it; see `RayScenes`."""
        return self

    def shorten_ranges(
        self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None
    ) -> None:
        """Shorten `ranges` (N,) in place to the first hit.

        A range that is already shorter than the first hit stays as it is, so
        that several ray scenes can be queried one after another.
        """
        self.triangles.intersect(origins, directions, ranges, _NO_FACES, _NO_NORMALS, order)

    def hit_faces(
        self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None
    ) -> NDArray[np.int32]:
        """Faces of the first hits, (N,), -1 for a miss; `ranges` (N,) are shortened in place."""
        faces = np.empty(len(directions), np.int32)
        self.triangles.intersect(origins, directions, ranges, faces, _NO_NORMALS, order)
        return faces

    def hits(self, origins: Floats, directions: Floats, ranges: Floats, order: Order = None) -> Hits:
        """First hits of the rays; `ranges` (N,) are shortened in place as by `shorten_ranges`."""
        faces = np.empty(len(directions), np.int32)
        normals = np.empty((len(directions), 3), np.float32)
        self.triangles.intersect(origins, directions, ranges, faces, normals, order)
        return Hits(faces, ranges, normals)

    def first_hit(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], range_m: float
    ) -> tuple[Floats, Floats]:
        """Range to the first hit (N,), `range_m` for a miss, and its normal (N, 3), not normalised."""
        ranges = np.full(len(directions), range_m, np.float32)
        hit = self.hits(
            np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32), ranges
        )
        return hit.range, hit.normal

    def topmost(self, xy: Array, top_m: float, reach_m: float) -> Array:
        """Heights (N,) [m] of the first surface below `top_m` at points (N, 2), -inf beyond `reach_m`."""
        origins = np.column_stack([xy, np.full(len(xy), top_m)])
        hit, _ = self.first_hit(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape), reach_m)
        return np.where(hit < reach_m, top_m - hit, -np.inf)

    def any_hit(self, origins: Floats, directions: Floats) -> Flags:
        """Whether each ray, of unlimited length, hits any triangle, (N,)."""
        return self.triangles.occluded(origins, directions)
