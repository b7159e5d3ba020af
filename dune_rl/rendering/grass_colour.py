"""Colours of tall grass."""

import numpy as np

from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.light import Light, srgb_to_linear

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
    upward = np.zeros((len(albedo), 3), np.float32)
    upward[:, 2] = 1.0
    # Blades have all orientations, so they get less direct light than level ground.
    return light.shade(
        albedo, upward, sunlit * np.float32(0.8), (0.35 + 0.65 * height[:, 0]).astype(np.float32)
    )


def grass_albedo() -> Floats:
    """Mean albedo of grass, linear RGB (3,)."""
    return srgb_to_linear(np.array(_MEAN_COLOUR))
