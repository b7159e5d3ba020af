"""What lies between an eye and what it sees: haze, and tall grass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.foliage import Foliage, BatchedFoliage, FoliageTransmission
from dune_rl.rendering.grass_colour import grass_colours
from dune_rl.rendering.light import Light, tone_map_to_srgb
from dune_rl.rendering.weather import Haze

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]

_TONES, _BRIGHTEST = 4096, 4.0
_LINEAR = np.linspace(0.0, _BRIGHTEST, _TONES, dtype=np.float32)
_ENCODED = tone_map_to_srgb(_LINEAR) * np.float32(255.0)
_TO_BYTES = (_ENCODED + np.float32(0.5)).astype(np.uint8)
_FROM_BYTES = np.interp(np.arange(256), _ENCODED, _LINEAR).astype(np.float32)


@dataclass(frozen=True, eq=False)
class BeamMedia:
    """What beams of M scenes pass: a haze that is the same for all, and grass that may differ."""

    haze: Haze | None
    foliage: BatchedFoliage | None


@dataclass(frozen=True, eq=False)
class ParticipatingMedia:
    """Both, or None for each that there is none of."""

    haze: Haze | None = None
    foliage: Foliage | None = None

    @property
    def clear(self) -> bool:
        """Whether there is nothing in it."""
        return self.haze is None and self.foliage is None

    def through(
        self, colours: Bytes, ranges: Floats, nothing: NDArray[np.bool_], veil: FoliageTransmission | None, light: Light
    ) -> Bytes:
        """Bytes (N, 3) for a screen of things of `colours` (N, 3) at `ranges` (N,) [m], behind a `transmission`.

        `nothing` (N,) tells where only the sky is, whose colour has the haze in
        it already. Light is mixed as light: in linear RGB.
        """
        mixed = _FROM_BYTES.take(colours)
        if self.haze is not None:
            mixed = self.haze.over(mixed, np.where(nothing, np.float32(0.0), ranges))
        if veil is not None:
            hidden = np.flatnonzero(veil.passed < 1.0)
            near = FoliageTransmission(*(part[hidden] for part in veil))
            grass = grass_colours(light, near.height, near.tint, np.ones(len(hidden), np.float32))
            if self.haze is not None:
                grass = self.haze.over(grass, near.distance)
            mixed[hidden] = grass + (mixed[hidden] - grass) * near.passed[:, None]
        index = (mixed * np.float32((_TONES - 1) / _BRIGHTEST) + np.float32(0.5)).astype(np.int32)
        return _TO_BYTES.take(index, mode="clip")
