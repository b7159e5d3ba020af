"""The sky of pictures: the light's colours, a glow around the sun, and fair-weather clouds."""

import numpy as np
from scipy import ndimage

from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.light import Light
from dune_rl.rendering.weather import Haze

_TEXELS = 512
# Size of the repeated tile of clouds, in heights of the cloud layer.
_TILE = 6.0


class Sky:
    """The sky of a `Light`, with equal clouds in every picture, attenuated by `haze`.

    The light must include the haze.
    """

    def __init__(self, light: Light, haze: Haze | None = None) -> None:
        self._light = light
        self._haze = haze
        draws = np.random.default_rng(7).standard_normal((_TEXELS, _TEXELS))
        heaps = sum(
            ndimage.gaussian_filter(draws, sigma, mode="wrap") * sigma * weight
            for sigma, weight in ((34.0, 1.5), (14.0, 1.0), (6.0, 0.55), (2.5, 0.3))
        )
        heaps = heaps / np.std(heaps)
        cover = np.clip((heaps - 0.25) / 1.3, 0.0, 1.0)
        self._cover = (cover * cover * (3.0 - 2.0 * cover)).astype(np.float32).ravel()

    def colours(self, directions: Floats) -> Floats:
        """Linear RGB (N, 3) along unit vectors (N, 3)."""
        light = self._light
        up = directions[:, 2]
        colours = light.sky(up)
        towards_sun = np.maximum(directions @ light.to_sun, 0.0)
        colours += (0.22 * towards_sun**12 + 6.0 * (towards_sun > 0.99985))[:, None] * light.sun
        high = np.flatnonzero(up > 0.02)
        if len(high):
            at = directions[high, :2] / (up[high, None] + 0.06) * np.float32(_TEXELS / _TILE)
            cell = at.astype(np.int32) & (_TEXELS - 1)
            cover = self._cover.take(cell[:, 1] * _TEXELS + cell[:, 0])
            # Clouds fade towards the horizon, where the air hides them.
            cover *= np.clip((up[high] - 0.02) * 5.0, 0.0, 1.0) * 0.75
            if self._haze is not None:
                cover *= self._haze.sky_transmittance(up[high])
            white = 0.42 * light.sun + 0.2 * light.horizon
            colours[high] += cover[:, None] * (white - colours[high])
        return colours.astype(np.float32)
