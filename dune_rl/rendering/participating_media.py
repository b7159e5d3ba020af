"""Participating media between a sensor and surfaces: haze, and tall grass with its colours."""

from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Bytes, Flags, Floats
from dune_rl.rendering.foliage import BatchedFoliage, Foliage, FoliageTransmission
from dune_rl.rendering.light import Light, srgb_to_linear, tone_map_to_srgb
from dune_rl.rendering.weather import Haze

TONES, BRIGHTEST = 4096, 4.0
_LINEAR = np.linspace(0.0, BRIGHTEST, TONES, dtype=np.float32)
_ENCODED = tone_map_to_srgb(_LINEAR) * np.float32(255.0)
TONES_TO_BYTES = (_ENCODED + np.float32(0.5)).astype(np.uint8)
TONES_FROM_BYTES = np.interp(np.arange(256), _ENCODED, _LINEAR).astype(np.float32)


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

        `colours` (N, 3) are sRGB bytes without media, `ranges` (N,) [m] distances. `nothing` (N,) marks rays
        to the sky, whose colour includes the haze. Mixing is done in linear RGB.
        """
        mixed = TONES_FROM_BYTES.take(colours)
        if self.haze is not None:
            mixed = self.haze.blend_over(mixed, np.where(nothing, np.float32(0.0), ranges))
        if transmission is not None:
            hidden = np.flatnonzero(transmission.passed < 1.0)
            near = FoliageTransmission(*(values[hidden] for values in transmission))
            grass = grass_colours(light, near.height, near.tint, np.ones(len(hidden), np.float32))
            if self.haze is not None:
                grass = self.haze.blend_over(grass, near.distance)
            mixed[hidden] = grass + (mixed[hidden] - grass) * near.passed[:, None]
        index = (mixed * np.float32((TONES - 1) / BRIGHTEST) + np.float32(0.5)).astype(np.int32)
        return TONES_TO_BYTES.take(index, mode="clip")


# sRGB of shaded, fresh and dry blades.
_SHADED, _FRESH, _DRY = (0.15, 0.20, 0.07), (0.42, 0.50, 0.20), (0.68, 0.64, 0.38)
_MEAN_COLOUR = (0.40, 0.44, 0.19)


def grass_colours(light: Light, height: Floats, tint: Floats, sunlit: Floats) -> Floats:
    """Linear RGB (N, 3) of grass at relative `height` (N,) with `tint` (N,) and `sunlit` share (N,)."""
    shaded, fresh, dry = (srgb_to_linear(np.array(colour)) for colour in (_SHADED, _FRESH, _DRY))
    height, tint = np.clip(height, 0.0, 1.0)[:, None], np.clip(tint, 0.0, 1.0)[:, None]
    # Tips are drier than stems.
    tips = fresh + (dry - fresh) * np.clip(tint * (0.4 + height), 0.0, 1.0)
    albedo = (shaded + (tips - shaded) * height**0.8).astype(np.float32)
    upward = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), albedo.shape)
    sky_share = (0.35 + 0.65 * height[:, 0]).astype(np.float32)
    # Blades have all orientations, so they get less direct light than level ground.
    return light.shade(albedo, upward, sunlit * np.float32(0.8), sky_share)


def grass_albedo() -> Floats:
    """Mean albedo of grass, linear RGB (3,)."""
    return srgb_to_linear(np.array(_MEAN_COLOUR))
