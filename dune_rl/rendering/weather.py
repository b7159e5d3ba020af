"""Fog, dust and time of day: attenuation of light, the sun's position, and the sky of pictures."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.light import Channel, Light, LightConf, srgb_to_linear

# Koschmieder (1924): black objects are visible up to a contrast of 2 % with the sky; -ln 0.02 = 3.912.
_KOSCHMIEDER = 3.912
# Height of fog banks and dust clouds, and the largest path length through them, towards the horizon.
_LAYER_M, _TO_HORIZON_M = 150.0, 5_000.0
# Ratio of zenith to horizon of a hazy sky; the CIE's standard overcast sky has 3.
_BRIGHTER_OVERHEAD = 1.8
# Northern latitude of the sun's path.
_LATITUDE_RAD = np.pi / 4
_RAD_PER_HOUR = np.pi / 12


class WeatherConf(Settings):
    """Visibilities and colours (sRGB) of fog and dust, and the light.

    Visibility is the distance at which the contrast of black objects falls to 2 %; null: clear air.
    `time_of_day_h`, if given, replaces the sun's position in `light` by that at this solar time at an
    equinox, 45 degrees north, in a world whose x axis points east.
    """

    fog_visibility_m: float | None = Field(None, gt=0.0, le=1e6)
    fog_colour: tuple[Channel, Channel, Channel] = (0.93, 0.94, 0.95)
    dust_visibility_m: float | None = Field(None, gt=0.0, le=1e6)
    dust_colour: tuple[Channel, Channel, Channel] = (0.85, 0.70, 0.50)
    time_of_day_h: float | None = Field(None, ge=6.25, le=17.75)
    light: LightConf = LightConf()

    @property
    def sunlight(self) -> LightConf:
        """`light` with the sun's position of the time of day."""
        if self.time_of_day_h is None:
            return self.light
        bearing, elevation = np.rad2deg(sun_position(self.time_of_day_h)).tolist()
        return self.light.model_copy(update={"sun_bearing_deg": bearing, "sun_elevation_deg": elevation})


@dataclass(frozen=True, eq=False)
class Haze:
    """Fog and dust together: extinction [1/m], and the linear RGB (3,) of the light that they scatter."""

    extinction: float
    colour: Floats

    @classmethod
    def from_weather(cls, weather: WeatherConf) -> "Haze | None":
        """The haze of a weather; None in clear air."""
        fog = weather.fog_visibility_m, weather.fog_colour
        dust = weather.dust_visibility_m, weather.dust_colour
        parts = [
            (_KOSCHMIEDER / visibility, srgb_to_linear(np.array(colour)))
            for visibility, colour in (fog, dust)
            if visibility is not None
        ]
        if not parts:
            return None
        extinction = sum(share for share, _ in parts)
        colour = sum((share / extinction * colour for share, colour in parts), np.zeros(3))
        clear = Light.from_conf(weather.sunlight)
        # Droplets and grains scatter the light of sun and sky equally into all directions.
        glow = colour * (0.5 * clear.horizon + 0.2 * clear.sun)
        return cls(extinction, glow.astype(np.float32))

    def transmittance(self, ranges: Floats) -> Floats:
        """Share (...) of light that passes `ranges` (...) [m] of haze, by the Beer-Lambert law."""
        return np.exp(ranges * np.float32(-self.extinction))

    def sky_transmittance(self, up: Floats) -> Floats:
        """Share (...) of light from the sky that passes the haze, for directions of z `up` (...) > 0."""
        return self.transmittance(np.minimum(np.float32(_LAYER_M) / up, np.float32(_TO_HORIZON_M)))

    def blend_over(self, colours: Floats, ranges: Floats) -> Floats:
        """Linear RGB (N, 3) of surfaces of `colours` (N, 3) seen through `ranges` (N,) [m] of haze."""
        return self.colour + (colours - self.colour) * self.transmittance(ranges)[:, None]


def weather_light(weather: WeatherConf) -> Light:
    """Sun and sky of a weather: haze dims the sun and covers the sky, mostly towards the horizon."""
    clear, haze = Light.from_conf(weather.sunlight), Haze.from_weather(weather)
    if haze is None:
        return clear
    to_sun, up, level = haze.sky_transmittance(np.array([clear.to_sun[2], 1.0, 1e-6], np.float32))
    overhead = _BRIGHTER_OVERHEAD * haze.colour
    return replace(
        clear,
        sun=(clear.sun * to_sun).astype(np.float32),
        zenith=(overhead + (clear.zenith - overhead) * up).astype(np.float32),
        horizon=(haze.colour + (clear.horizon - haze.colour) * level).astype(np.float32),
    )


def sun_position(hour: float) -> tuple[float, float]:
    """Bearing from the x axis and elevation [rad] of the sun at a solar `hour` [h]; see `WeatherConf`.

    It follows from the Earth's rotation, since the sun is above the equator at an equinox.
    """
    turn = (hour - 12.0) * _RAD_PER_HOUR
    east, north = -np.sin(turn), -np.cos(turn) * np.sin(_LATITUDE_RAD)
    up = np.cos(turn) * np.cos(_LATITUDE_RAD)
    return float(np.arctan2(north, east)), float(np.arcsin(up))


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
            scipy.ndimage.gaussian_filter(draws, sigma, mode="wrap") * sigma * weight
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
