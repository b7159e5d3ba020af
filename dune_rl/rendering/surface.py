"""What a beam meets: the segment of every face of a mesh, and how bright it is."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.shared_per_scene import DerivedCache, SharedPerScene
from dune_rl.rendering.scenery import Segment

Floats = NDArray[np.float32]

# Of linear red, green and blue (ITU-R BT.709).
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True, eq=False)
class BeamSurface:
    """Segments (F + 1,) and albedo luminances (F + 1,), in [0, 1], of the F faces of a mesh.

    The last entry is that of a ray that meets nothing, whose face is -1.
    """

    segments: NDArray[np.uint8]
    luminance: Floats

    def look_up(self, face: NDArray[np.int32]) -> tuple[NDArray[np.uint8], Floats]:
        """Segments and luminances (N,) each of faces (N,)."""
        return self.segments.take(face, mode="wrap"), self.luminance.take(face, mode="wrap")

    def select_scenes(self, scenes: NDArray[np.int64]) -> Self:
        """Itself: it is the same for all scenes; see `BatchedBeamSurfaces`."""
        return self

    @classmethod
    def of(cls, segments: NDArray[np.uint8], albedo: Floats) -> Self:
        """That of faces with `segments` (F,) and `albedo` (F, 3) in linear RGB."""
        return cls(
            np.append(segments, np.uint8(Segment.SKY)),
            np.append(luminance(albedo), np.float32(0.0)),
        )


class BatchedBeamSurfaces:
    """A `BeamSurface` for each of M scenes; faces are those of all scenes, scene after scene."""

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

    def select_scenes(self, scenes: NDArray[np.int64]) -> "Surfaces":
        """Those of some scenes (m,), counted from 0 in their order."""
        return BatchedBeamSurfaces(SharedPerScene([self._surfaces[scene] for scene in scenes.tolist()]))


def luminance(albedo: Floats) -> Floats:
    """Luminance (...) of linear RGB (..., 3)."""
    weighed: Floats = albedo @ _WEIGHTS
    return weighed
