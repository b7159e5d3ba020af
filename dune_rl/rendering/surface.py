"""What a beam meets: the segment of every face of a mesh, and how bright it is."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.scenery import Segment

Floats = NDArray[np.float32]

# Of linear red, green and blue (ITU-R BT.709).
_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True, eq=False)
class Surface:
    """Segments (F + 1,) and albedo luminances (F + 1,), in [0, 1], of the F faces of a mesh.

    The last entry is that of a ray that meets nothing, whose face is -1.
    """

    segments: NDArray[np.uint8]
    luminance: Floats

    @classmethod
    def of(cls, segments: NDArray[np.uint8], albedo: Floats) -> Self:
        """That of faces with `segments` (F,) and `albedo` (F, 3) in linear RGB."""
        return cls(
            np.append(segments, np.uint8(Segment.SKY)),
            np.append(luminance(albedo), np.float32(0.0)),
        )


def luminance(albedo: Floats) -> Floats:
    """Luminance (...) of linear RGB (..., 3)."""
    weighed: Floats = albedo @ _WEIGHTS
    return weighed
