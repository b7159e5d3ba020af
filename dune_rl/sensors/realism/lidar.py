"""What light adds to true ranges: noise, drop-out, and far, slanted or dark things that return nothing."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.draws import draw, normal, uniform
from dune_rl.sensors.realism.pipeline import RealismConf
from dune_rl.state.state import GroupState

# Three neighbouring returns lie on one flat thing if they miss a straight line by less than this share.
_FLAT = 0.1


class LidarRealismConf(RealismConf):
    """Faults of each beam.

    A range has noise of deviation `noise_m` + `noise_share` * range. The share of beams that return falls
    with the light that comes back, which goes as reflectance * cos(slant) / range²; `half_return_m` is of
    things that are met head-on.
    """

    kind = "lidar"

    noise_m: float = Field(0.0, ge=0.0, le=10.0, description="standard deviation of a range [m]")
    noise_share: float = Field(0.0, ge=0.0, le=1.0, description="its growth, as a share of the range")
    quantum_m: float = Field(0.0, ge=0.0, le=10.0, description="step between two ranges [m]")
    dropout: float = Field(0.0, ge=0.0, le=1.0, description="share of the beams that return nothing")
    half_return_m: float | None = Field(
        None, gt=0.0, le=10_000.0, description="range at which half of the beams return [m]; null: all"
    )
    reflectance: tuple[float, float] = Field(
        (1.0, 1.0), description="lowest and highest reflectance of an episode, over that of `half_return_m`"
    )

    @model_validator(mode="after")
    def _low_to_high(self) -> Self:
        low, high = self.reflectance
        if not 0.0 < low <= high <= 10.0:
            raise ValueError(
                "reflectance must be two numbers above 0 and at most 10, the lower first "
                f"(got {low:g}, {high:g})"
            )
        return self


class BeamFaults:
    """Ranges as a real LiDAR gives them; they depend on the true ones and on the moment alone."""

    segment: Segment | None = None
    luminance = 0.0

    def __init__(
        self, conf: LidarRealismConf, limits_m: tuple[float, float], name: str, bearings: Array | None = None
    ) -> None:
        """For ranges between two `limits_m`; `name` tells the draws of several sensors apart.

        `bearings` [rad] are those of beams in one plane; without them all count as met head-on.
        """
        self._conf, self._name, self._limits_m = conf, name, limits_m
        apart = 0.0 if bearings is None or len(bearings) < 3 else float(bearings[1] - bearings[0])
        # Beams so far apart tell nothing of what lies between them.
        self._slanted = 0.0 < apart < np.pi / 4
        # A full circle leaves out its last beam, which would repeat the first.
        self._full_circle = bearings is not None and bool(np.isclose(len(bearings) * apart, 2 * np.pi))
        self._cos, self._sin = np.float32(np.cos(apart)), np.float32(np.sin(apart))

    def applied(self, ranges: Floats, now: GroupState) -> Floats:
        """`ranges` (N, n_beams) [m] with faults: `range_m` where nothing returns, otherwise within limits."""
        conf = self._conf
        nearest, farthest = (np.float32(limit) for limit in self._limits_m)
        returned = ranges < farthest
        if conf.dropout > 0.0 or conf.half_return_m is not None:
            chance = draw(uniform, now.episode, f"{self._name} return", ranges.shape[1])
            returned &= chance < self._return_share(ranges, now)
        measured = ranges
        if conf.noise_m > 0.0 or conf.noise_share > 0.0:
            noise = draw(normal, now.episode, f"{self._name} noise", ranges.shape[1])
            noise *= np.float32(conf.noise_m) + np.float32(conf.noise_share) * ranges
            measured = ranges + noise
        if conf.quantum_m > 0.0:
            measured = np.rint(measured / np.float32(conf.quantum_m)) * np.float32(conf.quantum_m)
        measured = np.minimum(np.maximum(measured, nearest), farthest)
        return np.where(returned, measured, farthest)

    def _return_share(self, ranges: Floats, now: GroupState) -> Floats:
        """Share (N, n_beams) of beams that return.

        Photons come back at random (a Poisson process), and one is enough: 1 - 2^-(reflectance * cos(slant) *
        (half_return_m / range)²), in the far nearly proportional to 1 / range². After the LiDAR equation for
        something matt that fills the beam.
        """
        conf = self._conf
        stays = np.float32(1.0 - conf.dropout)
        if conf.half_return_m is None:
            return np.full_like(ranges, stays)
        low, high = conf.reflectance
        drawn = draw(uniform, now.episode, f"{self._name} reflectance", 1, once=True)
        reflectance = low + (high - low) * drawn
        near: Floats = np.reciprocal(np.maximum(ranges, np.float32(1e-3)))
        light = near * near * self._cos_slant(near)
        light *= (reflectance * conf.half_return_m**2).astype(np.float32)
        share: Floats = stays * (np.float32(1.0) - np.exp2(-light))
        return share

    def _cos_slant(self, near: Floats) -> Floats:
        """Cosine (N, n_beams) of the angle at which beams of inverse range `near` meet what they meet.

        Along a straight wall, inverse range is a sine of the bearing: its neighbours tell both whether it is
        one and how it slants. What is not flat, or seen by a single beam, counts as met head-on.
        """
        head_on = np.ones_like(near)
        if not self._slanted:
            return head_on
        before, after = np.roll(near, 1, axis=1), np.roll(near, -1, axis=1)
        flat = np.abs(before + after - 2 * self._cos * near) < np.float32(_FLAT) * near
        if not self._full_circle:
            flat[:, [0, -1]] = False
        tangent = (after - before) / (2 * self._sin * near)
        cosine: Floats = np.where(flat, 1.0 / np.sqrt(1.0 + tangent * tangent), head_on)
        return cosine
