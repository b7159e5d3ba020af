"""Ray scenes and terrains of M scenes that may each have their own, asked as if there were one."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import DerivedCache, SharedPerScene, query_grouped
from dune_rl.geometry.rays import Hits, RayScene

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class BatchedRayScenes:
    """A `RayScene` for each of M scenes, with the same queries.

    Origins (S, 3) and rays (N, 3) are those of all scenes, scene after scene:
    each scene has S / M of the origins and N / M of the rays.
    """

    def __init__(self, scenes: SharedPerScene[RayScene] | DerivedCache[Any, RayScene]) -> None:
        self._scenes = scenes

    def __len__(self) -> int:
        return len(self._scenes)

    def select_scenes(self, scenes: NDArray[np.int64]) -> "RayScenes":
        """Those of some scenes (m,), counted from 0 in their order."""
        return BatchedRayScenes(SharedPerScene([self._scenes[scene] for scene in scenes.tolist()]))

    def shorten_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> None:
        """As `RayScene.shorten_ranges`."""
        groups = self._scenes.groups
        if len(groups) == 1:
            groups[0][0].shorten_ranges(origins, directions, ranges)
            return
        by_scene = ranges.reshape(len(self._scenes), -1)
        for rays, rows in groups:
            part = by_scene[rows].ravel()
            rays.shorten_ranges(self._part(origins, rows), self._part(directions, rows), part)
            by_scene[rows] = part.reshape(-1, by_scene.shape[1])

    def hits(self, origins: Floats, directions: Floats, ranges: Floats) -> Hits:
        """As `RayScene.hits`; a face is one of its own scene's triangles."""
        groups = self._scenes.groups
        if len(groups) == 1:
            return groups[0][0].hits(origins, directions, ranges)
        face = np.empty(len(directions), np.int32)
        normal = np.empty((len(directions), 3), np.float32)
        scenes = len(self._scenes)
        for rays, rows in groups:
            part = ranges.reshape(scenes, -1)[rows].ravel()
            found = rays.hits(self._part(origins, rows), self._part(directions, rows), part)
            count = len(part) // len(directions.reshape(scenes, -1, 3)[rows])
            face.reshape(scenes, -1)[rows] = found.face.reshape(-1, count)
            ranges.reshape(scenes, -1)[rows] = found.range.reshape(-1, count)
            normal.reshape(scenes, -1, 3)[rows] = found.normal.reshape(-1, count, 3)
        return Hits(face, ranges, normal)

    def any_hit(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """As `RayScene.any_hit`."""
        groups = self._scenes.groups
        if len(groups) == 1:
            return groups[0][0].any_hit(origins, directions)
        found = np.empty(len(directions), np.bool_)
        by_scene = found.reshape(len(self._scenes), -1)
        for rays, rows in groups:
            blocked = rays.any_hit(self._part(origins, rows), self._part(directions, rows))
            by_scene[rows] = blocked.reshape(-1, by_scene.shape[1])
        return found

    def _part(self, values: Floats, rows: Any) -> Floats:
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
