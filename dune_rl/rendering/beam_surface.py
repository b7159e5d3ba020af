"""Surface properties that LiDAR beams measure: the segment and luminance of every face of a mesh."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Floats
from dune_rl.geometry.shared_per_scene import DerivedCache, SharedPerScene
from dune_rl.rendering.scenery import Segment

# Weights of linear red, green and blue (ITU-R BT.709).
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True, eq=False)
class BeamSurface:
    """Segments (F + 1,) and albedo luminances (F + 1,) in [0, 1] of the F faces of a mesh.

    The last entry is for a ray without a hit, whose face is -1.
    """

    segments: NDArray[np.uint8]
    luminance: Floats

    def look_up(self, face: NDArray[np.int32]) -> tuple[NDArray[np.uint8], Floats]:
        """Segments (N,) and luminances (N,) of faces (N,)."""
        return self.segments.take(face, mode="wrap"), self.luminance.take(face, mode="wrap")

    def select_scenes(self, scenes: NDArray[np.int64]) -> Self:
        """Itself, since all scenes share it; see `BatchedBeamSurfaces`."""
        return self

    @classmethod
    def from_faces(cls, segments: NDArray[np.uint8], albedo: Floats) -> Self:
        """The surface of faces with `segments` (F,) and `albedo` (F, 3) in linear RGB."""
        return cls(
            np.append(segments, np.uint8(Segment.SKY)),
            np.append(luminance(albedo), np.float32(0.0)),
        )


class BatchedBeamSurfaces:
    """A `BeamSurface` for each of M scenes; faces are scene-major."""

    def __init__(self, surfaces: SharedPerScene[BeamSurface] | DerivedCache[Any, BeamSurface]) -> None:
        self._surfaces = surfaces

    def look_up(self, face: NDArray[np.int32]) -> tuple[NDArray[np.uint8], Floats]:
        """As `Surface.look_up`."""
        groups = self._surfaces.groups
        if len(groups) == 1:
            return groups[0][0].look_up(face)
        by_scene = face.reshape(len(self._surfaces), -1)
        segments, brightness = np.empty(by_scene.shape, np.uint8), np.empty(by_scene.shape, np.float32)
        for surface, rows in groups:
            segments[rows], brightness[rows] = surface.look_up(by_scene[rows])
        return segments.ravel(), brightness.ravel()

    def select_scenes(self, scenes: NDArray[np.int64]) -> "BatchedBeamSurfaces":
        """The surfaces of `scenes` (m,) only, renumbered from 0 in that order."""
        return BatchedBeamSurfaces(SharedPerScene([self._surfaces[scene] for scene in scenes.tolist()]))


def luminance(albedo: Floats) -> Floats:
    """Luminance (...) of linear RGB (..., 3)."""
    weighted: Floats = albedo @ _WEIGHTS
    return weighted
