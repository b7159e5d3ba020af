"""Sun and sky, shading of surfaces, and conversion between linear RGB and sRGB."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Floats

Channel = Annotated[float, Field(ge=0.0, le=1.0)]

_SUN_HIGH, _SUN_LOW = np.array([2.05, 1.96, 1.80]), np.array([1.75, 0.95, 0.45])
_ZENITH, _ZENITH_LOW = np.array([0.16, 0.32, 0.68]), np.array([0.12, 0.18, 0.38])
_HORIZON, _HORIZON_LOW = np.array([0.62, 0.74, 0.88]), np.array([0.85, 0.60, 0.42])


class LightConf(Settings):
    """Position of the sun: bearing from the world's x axis, and elevation above the horizon.

    `sun_colour` tints its light: only the ratios of red, green and blue count, and equal values are no tint.
    `brightness` scales the light of sun and sky.
    """

    sun_bearing_deg: float = Field(126.0, ge=-360.0, le=360.0)
    sun_elevation_deg: float = Field(43.0, ge=1.0, le=90.0)
    shadows: bool = True
    sun_colour: tuple[Channel, Channel, Channel] = (1.0, 1.0, 1.0)
    brightness: float = Field(1.0, gt=0.0, le=10.0)


@dataclass(frozen=True)
class Light:
    """Unit vector to the sun, and linear RGB of sun, zenith and horizon, each (3,)."""

    to_sun: Floats
    sun: Floats
    zenith: Floats
    horizon: Floats
    shadows: bool

    @classmethod
    def from_conf(cls, conf: LightConf) -> "Light":
        """The light of `conf`. A low sun is dimmer and redder, and so is the sky."""
        bearing, elevation = np.deg2rad([conf.sun_bearing_deg, conf.sun_elevation_deg])
        height, level = np.sin(elevation), np.cos(elevation)
        # The light turns from red to white with the elevation, up to about 33 degrees.
        high = min(1.0, height / 0.55) ** 0.7
        tint = np.array(conf.sun_colour) / max(*conf.sun_colour, 1e-6)
        bright = conf.brightness
        return cls(
            np.array([level * np.cos(bearing), level * np.sin(bearing), height], np.float32),
            (bright * tint * (_SUN_LOW + high * (_SUN_HIGH - _SUN_LOW))).astype(np.float32),
            (bright * (_ZENITH_LOW + high * (_ZENITH - _ZENITH_LOW))).astype(np.float32),
            (bright * (_HORIZON_LOW + high * (_HORIZON - _HORIZON_LOW))).astype(np.float32),
            conf.shadows,
        )

    def shade(self, albedo: Floats, normals: Floats, sunlit: Floats, sky_share: Floats) -> Floats:
        """Linear RGB (..., 3) of diffuse surfaces with `albedo` (..., 3) and unit `normals` (..., 3).

        `sunlit` (...) and `sky_share` (...) are the visible shares of sun and
        sky. Some light comes from the ground below, too.
        """
        facing = np.maximum(normals @ self.to_sun, 0.0) * sunlit
        upward = ((1.0 + normals[..., 2]) / 2 * sky_share)[..., None]
        bounce = self.from_ground * (1.0 - upward) * sky_share[..., None]
        return albedo * (facing[..., None] * self.sun + upward * self.from_sky + bounce)

    @property
    def from_sky(self) -> Floats:
        """Linear RGB (3,) of the sky's light on a surface that faces up."""
        return 0.55 * self.zenith + 0.25 * self.horizon

    @property
    def from_ground(self) -> Floats:
        """Linear RGB (3,) of the ground's light on a surface that faces down."""
        return 0.10 * self.sun

    def sky(self, up: Floats) -> Floats:
        """Linear RGB (..., 3) of the sky where the direction's z is `up` (...), in [-1, 1]."""
        share = np.sqrt(np.clip(up, 0.0, 1.0))[..., None]
        return self.horizon + share * (self.zenith - self.horizon)


def tone_map_to_srgb(linear: Floats) -> Floats:
    """SRGB values in [0, 1] of linear values (...), with highlights compressed instead of clipped."""
    # Linear up to 0.5, then exponentially towards 1 with a continuous slope.
    bright = 0.5 + 0.5 * (1.0 - np.exp(-(np.maximum(linear, 0.5) - 0.5) / 0.5))
    return _encode(np.clip(np.where(linear > 0.5, bright, linear), 0.0, 1.0))


def linear_to_srgb(linear: Floats) -> Floats:
    """SRGB values in [0, 1] of linear values (...), clipped: the inverse of `srgb_to_linear`."""
    return _encode(np.clip(np.asarray(linear, np.float32), 0.0, 1.0))


def _encode(value: Floats) -> Floats:
    encoded: Floats = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return encoded.astype(np.float32)


def srgb_to_linear(encoded: Floats) -> Floats:
    """Linear values (...) of sRGB values in [0, 1], such as colours in files and settings."""
    value = np.asarray(encoded, np.float32)
    decoded: Floats = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return decoded.astype(np.float32)
