"""Ray scenes and height fields of M scenes, queried together; scenes may share theirs."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import Hits, RayScene
from dune_rl.geometry.shared_per_scene import DerivedCache, SharedPerScene, query_grouped


class BatchedRayScenes:
    """A `RayScene` for each of M scenes, with the same queries.

    Origins (S, 3) and directions (N, 3) are scene-major: each scene has S / M
    consecutive origins and N / M consecutive rays.
    """

    def __init__(self, scenes: SharedPerScene[RayScene] | DerivedCache[Any, RayScene]) -> None:
        self._scenes = scenes

    def __len__(self) -> int:
        return len(self._scenes)

    def select_scenes(self, scenes: NDArray[np.int64]) -> "BatchedRayScenes":
        """The ray scenes of `scenes` (m,) only, renumbered from 0 in that order."""
        return BatchedRayScenes(SharedPerScene([self._scenes[scene] for scene in scenes.tolist()]))

    def shorten_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> None:
        """As `RayScene.shorten_ranges`."""
        groups = self._scenes.groups
        if len(groups) == 1:
            groups[0][0].shorten_ranges(origins, directions, ranges)
            return
        by_scene = ranges.reshape(len(self._scenes), -1)
        for rays, rows in groups:
            own = by_scene[rows].ravel()
            rays.shorten_ranges(self._rows(origins, rows), self._rows(directions, rows), own)
            by_scene[rows] = own.reshape(-1, by_scene.shape[1])

    def hits(self, origins: Floats, directions: Floats, ranges: Floats) -> Hits:
        """As `RayScene.hits`; face indices refer to the triangles of the ray's own scene."""
        groups = self._scenes.groups
        if len(groups) == 1:
            return groups[0][0].hits(origins, directions, ranges)
        face = np.empty(len(directions), np.int32)
        normal = np.empty((len(directions), 3), np.float32)
        scenes = len(self._scenes)
        for rays, rows in groups:
            own = ranges.reshape(scenes, -1)[rows].ravel()
            hit = rays.hits(self._rows(origins, rows), self._rows(directions, rows), own)
            count = len(own) // len(directions.reshape(scenes, -1, 3)[rows])
            face.reshape(scenes, -1)[rows] = hit.face.reshape(-1, count)
            ranges.reshape(scenes, -1)[rows] = hit.range.reshape(-1, count)
            normal.reshape(scenes, -1, 3)[rows] = hit.normal.reshape(-1, count, 3)
        return Hits(face, ranges, normal)

    def any_hit(self, origins: Floats, directions: Floats) -> Flags:
        """As `RayScene.any_hit`."""
        groups = self._scenes.groups
        if len(groups) == 1:
            return groups[0][0].any_hit(origins, directions)
        occluded = np.empty(len(directions), np.bool_)
        by_scene = occluded.reshape(len(self._scenes), -1)
        for rays, rows in groups:
            own = rays.any_hit(self._rows(origins, rows), self._rows(directions, rows))
            by_scene[rows] = own.reshape(-1, by_scene.shape[1])
        return occluded

    def _rows(self, values: Floats, rows: Any) -> Floats:
        return values.reshape(len(self._scenes), -1, 3)[rows].reshape(-1, 3)


class BatchedHeightFields:
    """A `HeightField` for each of M scenes.

    Points have the leading axis N = M * G, scene after scene.
    """

    def __init__(self, fields: SharedPerScene[HeightField] | DerivedCache[Any, HeightField]) -> None:
        self._fields = fields

    def height(self, xy: Array) -> Array:
        """Height [m], (N, ...), at points (N, ..., 2)."""
        groups = self._fields.groups
        if len(groups) == 1:
            return groups[0][0].height(xy)
        by_scene = xy.reshape(len(self._fields), -1, 2)
        return query_grouped(groups, HeightField.height, by_scene).reshape(xy.shape[:-1])


AnyRays: TypeAlias = RayScene | BatchedRayScenes
AnyTerrain: TypeAlias = HeightField | BatchedHeightFields
