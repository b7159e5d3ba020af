"""Fog, dust and the time of day: what the air does to light on its way."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.rendering.light import Channel, Light, LightConf, srgb_to_linear
from dune_rl.settings import Settings

Floats = NDArray[np.float32]

# Koschmieder (1924): something black is seen as far as it differs from the sky by 2 %; -ln 0.02 = 3.912.
_KOSCHMIEDER = 3.912
# A fog bank or a dust cloud reaches this high; toward the horizon one looks through this much of it.
_LAYER_M, _TO_HORIZON_M = 150.0, 5_000.0
# An overcast sky is brighter overhead than at the horizon: up to three times by the standard of the CIE.
_BRIGHTER_OVERHEAD = 1.8
# Where the sun stands is told for this latitude, north.
_LATITUDE_RAD = np.pi / 4
_RAD_PER_HOUR = np.pi / 12


class WeatherConf(Settings):
    """How far one sees through fog and through dust, their colours, and the light.

    Null is as far as one likes. Visibility is the distance at which black things fade to 2 % of contrast.
    Colours are sRGB. `time_of_day_h`, where it is given, puts the sun where it
    stands at that solar time at an equinox, 45 degrees north, in a world whose
    x axis points east, instead of where `light` has it.
    """

    fog_visibility_m: float | None = Field(None, gt=0.0, le=1e6)
    fog_colour: tuple[Channel, Channel, Channel] = (0.93, 0.94, 0.95)
    dust_visibility_m: float | None = Field(None, gt=0.0, le=1e6)
    dust_colour: tuple[Channel, Channel, Channel] = (0.85, 0.70, 0.50)
    time_of_day_h: float | None = Field(None, ge=6.25, le=17.75)
    light: LightConf = LightConf()

    @property
    def sunlight(self) -> LightConf:
        """`light`, its sun moved to the time of day."""
        if self.time_of_day_h is None:
            return self.light
        bearing, elevation = sun_position(self.time_of_day_h)
        return self.light.model_copy(update={"sun_bearing_rad": bearing, "sun_elevation_rad": elevation})


@dataclass(frozen=True, eq=False)
class Haze:
    """Fog and dust together: extinction [1/m], and the linear RGB (3,) that they glow with in daylight."""

    extinction: float
    colour: Floats

    @classmethod
    def of(cls, weather: WeatherConf) -> "Haze | None":
        """That of a weather, None in clear air."""
        parts = [
            (_KOSCHMIEDER / visibility, srgb_to_linear(np.array(colour)))
            for visibility, colour in (
                (weather.fog_visibility_m, weather.fog_colour),
                (weather.dust_visibility_m, weather.dust_colour),
            )
            if visibility is not None
        ]
        if not parts:
            return None
        extinction = sum(share for share, _ in parts)
        colour = sum((share / extinction * colour for share, colour in parts), np.zeros(3))
        clear = Light.of(weather.sunlight)
        # Droplets and grains are lit by sky and sun from all sides, wherever one looks.
        glow = colour * (0.5 * clear.horizon + 0.2 * clear.sun)
        return cls(extinction, glow.astype(np.float32))

    def transmittance(self, ranges: Floats) -> Floats:
        """Share (...) of light that passes `ranges` (...) [m] of it: Beer and Lambert's law."""
        passed: Floats = np.exp(ranges * np.float32(-self.extinction))
        return passed

    def above(self, up: Floats) -> Floats:
        """Share (...) of light that comes down through it where the direction's z is `up` (...), above 0."""
        return self.transmittance(np.minimum(np.float32(_LAYER_M) / up, np.float32(_TO_HORIZON_M)))

    def over(self, colours: Floats, ranges: Floats) -> Floats:
        """Linear RGB (N, 3) of things of `colours` (N, 3) seen through `ranges` (N,) [m] of it."""
        return self.colour + (colours - self.colour) * self.transmittance(ranges)[:, None]


def weather_light(weather: WeatherConf) -> Light:
    """Sun and sky of a weather: haze takes from the sun and covers the sky, most toward the horizon."""
    clear, haze = Light.of(weather.sunlight), Haze.of(weather)
    if haze is None:
        return clear
    to_sun, up, level = haze.above(np.array([clear.to_sun[2], 1.0, 1e-6], np.float32))
    overhead = _BRIGHTER_OVERHEAD * haze.colour
    return replace(
        clear,
        sun=(clear.sun * to_sun).astype(np.float32),
        zenith=(overhead + (clear.zenith - overhead) * up).astype(np.float32),
        horizon=(haze.colour + (clear.horizon - haze.colour) * level).astype(np.float32),
    )


def sun_position(hour: float) -> tuple[float, float]:
    """Bearing from the x axis and elevation [rad] of the sun at a solar `hour` [h]; see `WeatherConf`.

    From the rotation of the Earth alone: at an equinox the sun stands over the equator.
    """
    turn = (hour - 12.0) * _RAD_PER_HOUR
    east, north = -np.sin(turn), -np.cos(turn) * np.sin(_LATITUDE_RAD)
    up = np.cos(turn) * np.cos(_LATITUDE_RAD)
    return float(np.arctan2(north, east)), float(np.arcsin(up))
