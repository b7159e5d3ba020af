"""Participating media between a sensor and surfaces: haze and tall grass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.rendering.foliage import BatchedFoliage, Foliage, FoliageTransmission
from dune_rl.rendering.grass_colour import grass_colours
from dune_rl.rendering.light import Light, tone_map_to_srgb
from dune_rl.rendering.weather import Haze

Bytes = NDArray[np.uint8]

_TONES, _BRIGHTEST = 4096, 4.0
_LINEAR = np.linspace(0.0, _BRIGHTEST, _TONES, dtype=np.float32)
_ENCODED = tone_map_to_srgb(_LINEAR) * np.float32(255.0)
_TO_BYTES = (_ENCODED + np.float32(0.5)).astype(np.uint8)
_FROM_BYTES = np.interp(np.arange(256), _ENCODED, _LINEAR).astype(np.float32)


@dataclass(frozen=True, eq=False)
class BeamMedia:
    """Media for the beams of M scenes: one haze for all, and grass for each scene."""

    haze: Haze | None
    foliage: BatchedFoliage | None


@dataclass(frozen=True, eq=False)
class ParticipatingMedia:
    """Haze and grass of one world; None for what is absent."""

    haze: Haze | None = None
    foliage: Foliage | None = None

    @property
    def clear(self) -> bool:
        """Whether there are no media."""
        return self.haze is None and self.foliage is None

    def attenuate(
        self,
        colours: Bytes,
        ranges: Floats,
        nothing: Flags,
        transmission: FoliageTransmission | None,
        light: Light,
    ) -> Bytes:
        """Colours of surfaces seen through the media, sRGB bytes (N, 3).

        `colours` (N, 3) are sRGB bytes without media, `ranges` (N,) [m]
        distances. `nothing` (N,) marks rays to the sky, whose colour includes
        the haze. Mixing is done in linear RGB.
        """
        mixed = _FROM_BYTES.take(colours)
        if self.haze is not None:
            mixed = self.haze.blend_over(mixed, np.where(nothing, np.float32(0.0), ranges))
        if transmission is not None:
            hidden = np.flatnonzero(transmission.passed < 1.0)
            near = FoliageTransmission(*(values[hidden] for values in transmission))
            grass = grass_colours(light, near.height, near.tint, np.ones(len(hidden), np.float32))
            if self.haze is not None:
                grass = self.haze.blend_over(grass, near.distance)
            mixed[hidden] = grass + (mixed[hidden] - grass) * near.passed[:, None]
        index = (mixed * np.float32((_TONES - 1) / _BRIGHTEST) + np.float32(0.5)).astype(np.int32)
        return _TO_BYTES.take(index, mode="clip")
