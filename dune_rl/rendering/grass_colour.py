"""What colour tall grass has."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.light import Light, srgb_to_linear

Floats = NDArray[np.float32]

# sRGB of what grows in the shade of the rest, of fresh blades and of dry ones.
_SHADED, _FRESH, _DRY = (0.15, 0.20, 0.07), (0.42, 0.50, 0.20), (0.68, 0.64, 0.38)
_MEAN_COLOUR = (0.40, 0.44, 0.19)


def grass_colours(light: Light, height: Floats, tint: Floats, sunlit: Floats) -> Floats:
    """Linear RGB (N, 3) of grass seen at `height` and `tint` (N,), where `sunlit` (N,) of the sun comes."""
    shaded, fresh, dry = (srgb_to_linear(np.array(colour)) for colour in (_SHADED, _FRESH, _DRY))
    height, tint = np.clip(height, 0.0, 1.0)[:, None], np.clip(tint, 0.0, 1.0)[:, None]
    # Tips are drier than stems.
    tips = fresh + (dry - fresh) * np.clip(tint * (0.4 + height), 0.0, 1.0)
    albedo = (shaded + (tips - shaded) * height**0.8).astype(np.float32)
    upward = np.zeros((len(albedo), 3), np.float32)
    upward[:, 2] = 1.0
    # Blades stand at all angles: the sun meets them less squarely than the ground.
    return light.on(albedo, upward, sunlit * np.float32(0.8), (0.35 + 0.65 * height[:, 0]).astype(np.float32))


def grass_albedo() -> Floats:
    """Linear RGB (3,) of grass as a whole."""
    return srgb_to_linear(np.array(_MEAN_COLOUR))
