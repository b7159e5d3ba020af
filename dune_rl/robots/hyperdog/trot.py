"""A walking trot: two diagonal pairs of feet that take turns in the air."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.geometry.frames import clip
from dune_rl.settings import Settings

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Front left with rear right, front right with rear left; legs in the order of the hips.
_LATE = np.array([0.0, 0.5, 0.5, 0.0])
_SLOWEST_MPS, _SLOWEST_RADPS = 0.01, 0.02
_STEEPEST = 0.45
# Share of the way to their places that feet go in a control step, when the walk ends.
_SETTLE = 0.2


class TrotConf(Settings):
    """Shape of the gait.

    In a cycle of `cycle_s` each foot is in the air for `swing_share` of it,
    rising by `lift_m` on half a sine. The hips are carried `height_m` over the
    feet, which stand `out_m` outward of them. Tilted by more than
    `careful_from_rad` it walks more slowly, down to `careful_share` of the
    speed at `careful_to_rad`, which keeps it on its feet on stones and steps.
    """

    cycle_s: float = Field(0.5, ge=0.2, le=2.0)
    swing_share: float = Field(0.25, ge=0.1, le=0.5)
    lift_m: float = Field(0.06, gt=0.0, le=0.1)
    height_m: float = Field(0.22, ge=0.15, le=0.27)
    out_m: float = Field(0.10, ge=0.0, le=0.15)
    careful_from_rad: float = Field(0.18, ge=0.0, le=1.5)
    careful_to_rad: float = Field(0.42, ge=0.0, le=1.5)
    careful_share: float = Field(0.25, gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _careful_in_order(self) -> Self:
        if self.careful_to_rad <= self.careful_from_rad:
            raise ValueError(
                f"careful_to_rad must be above careful_from_rad "
                f"(got {self.careful_to_rad:g} and {self.careful_from_rad:g})"
            )
        return self


class Trot:
    """Where the four feet of each of M robots go, in the body frame."""

    def __init__(self, conf: TrotConf, hips_b: Array, num_scenes: int) -> None:
        self._conf = conf
        outward = conf.out_m * np.sign(hips_b[:, 1])
        self.rest_b: Array = hips_b + np.column_stack([np.zeros(4), outward, np.full(4, -conf.height_m)])
        self._phase = np.zeros(num_scenes)
        self._feet = np.tile(self.rest_b, (num_scenes, 1, 1))
        self._lift_off = self._feet.copy()

    def reset(self, mask: Flags) -> None:
        """Stand on all feet in the scenes in `mask` (M,)."""
        self._phase[mask] = 0.0
        self._feet[mask] = self.rest_b
        self._lift_off[mask] = self.rest_b

    def careful(self, tilt: Array) -> Array:
        """Share of the wanted speed (M,) that is walked at, by roll and pitch (M, 2) [rad]."""
        conf = self._conf
        steep = np.hypot(tilt[:, 0], tilt[:, 1]) - conf.careful_from_rad
        share = clip(steep / (conf.careful_to_rad - conf.careful_from_rad), 0.0, 1.0)
        return 1.0 - (1.0 - conf.careful_share) * share

    def feet(self, twist: Array, tilt: Array, step_s: float) -> Array:
        """Positions (M, 4, 3) [m] of the feet after a further `step_s`.

        `twist` (M, 2) is the speed to walk at [m/s] and the yaw rate [rad/s],
        and `tilt` (M, 2) the body's roll and pitch [rad]: on a slope feet land
        plumb under the hips. A robot that is to stand still stands on all feet.
        """
        conf = self._conf
        going = (np.abs(twist[:, 0]) > _SLOWEST_MPS) | (np.abs(twist[:, 1]) > _SLOWEST_RADPS)
        self._phase = np.where(going, (self._phase + step_s / conf.cycle_s) % 1.0, 0.0)
        phase = (self._phase[:, None] + _LATE) % 1.0
        swinging = (phase < conf.swing_share) & going[:, None]
        share = np.minimum(phase / conf.swing_share, 1.0)
        passing, plumb = self._passing(twist), self._plumb(tilt)
        # Half a stance ahead, so that the foot is plumb under its hip amid it.
        landing = plumb + passing * (conf.cycle_s * (1.0 - conf.swing_share) / 2)
        air = self._in_the_air(share, landing)
        ground = self._feet - step_s * passing
        ground[..., 2] = self.rest_b[:, 2]
        stand = self._feet + _SETTLE * (plumb - self._feet)
        self._feet = np.where(swinging[..., None], air, np.where(going[:, None, None], ground, stand))
        self._lift_off = np.where(swinging[..., None], self._lift_off, self._feet)
        return self._feet

    def _passing(self, twist: Array) -> Array:
        """Velocity of the body over the ground at each foot's place (M, 4, 3) [m/s]."""
        speed, turn = twist[:, :1], twist[:, 1:]
        along = speed - turn * self.rest_b[:, 1]
        across = turn * self.rest_b[:, 0]
        return np.stack([along, across, np.zeros_like(along)], axis=-1)

    def _plumb(self, tilt: Array) -> Array:
        """Where feet stand plumb under their hips (M, 4, 3) [m]."""
        lean = self._conf.height_m * clip(np.tan(tilt), -_STEEPEST, _STEEPEST)
        aside = np.stack([lean[:, 1], -lean[:, 0], np.zeros(len(tilt))], axis=-1)
        return np.asarray(self.rest_b + aside[:, None])

    def _in_the_air(self, share: Array, landing: Array) -> Array:
        eased = 0.5 - 0.5 * np.cos(np.pi * share)
        air = self._lift_off + eased[..., None] * (landing - self._lift_off)
        air[..., 2] += self._conf.lift_m * np.sin(np.pi * share)
        return air
