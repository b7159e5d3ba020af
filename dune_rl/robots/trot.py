"""A walking trot: two diagonal pairs of feet that take turns in the air."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import within
from dune_rl.robots.robot import BodyMotion
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
    feet, which stand `out_m` outward of them.
    """

    cycle_s: float = Field(0.5, ge=0.2, le=2.0)
    swing_share: float = Field(0.25, ge=0.1, le=0.5)
    lift_m: float = Field(0.045, gt=0.0, le=0.1)
    height_m: float = Field(0.22, ge=0.15, le=0.27)
    out_m: float = Field(0.10, ge=0.0, le=0.15)
    capture_s: float = Field(0.0, ge=0.0, le=0.5)
    level: float = Field(0.0, ge=0.0, le=2.0)
    tilt_filter_s: float = Field(0.0, ge=0.0, le=2.0)
    steepest: float = 0.45
    slow_from_rad: float = 0.4
    slow_to_rad: float = 0.65
    slowest: float = 1.0
    back_mps: float = 0.0


class Trot:
    """Where the four feet of each of M robots go, in the body frame."""

    def __init__(self, conf: TrotConf, hips_b: Array, num_scenes: int) -> None:
        self._conf = conf
        outward = conf.out_m * np.sign(hips_b[:, 1])
        self.rest_b: Array = hips_b + np.column_stack([np.zeros(4), outward, np.full(4, -conf.height_m)])
        self._phase = np.zeros(num_scenes)
        self._tilt = np.zeros((num_scenes, 2))
        self._feet = np.tile(self.rest_b, (num_scenes, 1, 1))
        self._lift_off = self._feet.copy()

    def reset(self, mask: Flags) -> None:
        """Stand on all feet in the scenes in `mask` (M,)."""
        self._phase[mask] = 0.0
        self._tilt[mask] = 0.0
        self._feet[mask] = self.rest_b
        self._lift_off[mask] = self.rest_b

    def feet(self, twist: Array, motion: BodyMotion, step_s: float) -> Array:
        """Positions (M, 4, 3) [m] of the feet after a further `step_s`.

        `twist` (M, 2) is the wanted speed [m/s] and yaw rate [rad/s], and
        `tilt` (M, 2) the body's roll and pitch [rad]: on a slope feet land
        plumb under the hips. A robot that is to stand still stands on all feet.
        """
        conf = self._conf
        share = 1.0 if conf.tilt_filter_s <= 0 else min(1.0, step_s / conf.tilt_filter_s)
        self._tilt = self._tilt + share * (motion.roll_pitch_yaw[:, :2] - self._tilt)
        tilt = self._tilt
        steep = np.hypot(tilt[:, 0], tilt[:, 1])
        much = within((steep - conf.slow_from_rad) / (conf.slow_to_rad - conf.slow_from_rad), 0.0, 1.0)
        twist = twist * (1 - (1 - conf.slowest) * much)[:, None]
        twist = np.column_stack([twist[:, 0] + conf.back_mps * much * np.sign(tilt[:, 1]), twist[:, 1]])
        going = (np.abs(twist[:, 0]) > _SLOWEST_MPS) | (np.abs(twist[:, 1]) > _SLOWEST_RADPS)
        self._phase = np.where(going, (self._phase + step_s / conf.cycle_s) % 1.0, 0.0)
        phase = (self._phase[:, None] + _LATE) % 1.0
        swinging = (phase < conf.swing_share) & going[:, None]
        share = np.minimum(phase / conf.swing_share, 1.0)
        air = self._in_the_air(share, self._landing(twist, tilt, motion.velocity_b))
        ground = self._feet - step_s * self._passing(twist)
        ground[..., 2] = self.rest_b[:, 2]
        stand = self._feet + _SETTLE * (self.rest_b + self._lean(tilt) - self._feet)
        self._feet = np.where(swinging[..., None], air, np.where(going[:, None, None], ground, stand))
        self._lift_off = np.where(swinging[..., None], self._lift_off, self._feet)
        return self._feet + self._posture(tilt)

    def _lean(self, tilt: Array) -> Array:
        lean = self._conf.height_m * within(np.tan(tilt), -self._conf.steepest, self._conf.steepest)
        return np.stack([lean[:, 1], -lean[:, 0], np.zeros(len(tilt))], axis=-1)[:, None]

    def _posture(self, tilt: Array) -> Array:
        roll, pitch = (self._conf.level * within(np.tan(tilt), -self._conf.steepest, self._conf.steepest)).T
        up = roll[:, None] * self.rest_b[:, 1] - pitch[:, None] * self.rest_b[:, 0]
        up = within(up, -0.05, 0.05)
        return np.stack([np.zeros_like(up), np.zeros_like(up), up], axis=-1)

    def _passing(self, twist: Array) -> Array:
        """Velocity of the body over the ground at each foot's place (M, 4, 3) [m/s]."""
        speed, turn = twist[:, :1], twist[:, 1:]
        along = speed - turn * self.rest_b[:, 1]
        across = turn * self.rest_b[:, 0]
        return np.stack([along, across, np.zeros_like(along)], axis=-1)

    def _landing(self, twist: Array, tilt: Array, velocity: Array) -> Array:
        """Where feet come down: half a stance ahead of the place plumb under their hips."""
        conf = self._conf
        stance_s = conf.cycle_s * (1.0 - conf.swing_share)
        excess = velocity[:, :2] - np.column_stack([twist[:, 0], np.zeros(len(twist))])
        caught = within(conf.capture_s * excess, -0.06, 0.06)
        aside = np.column_stack([caught, np.zeros(len(twist))])
        landing: Array = self.rest_b + self._passing(twist) * (stance_s / 2) + aside[:, None] + self._lean(tilt)
        return landing

    def _in_the_air(self, share: Array, landing: Array) -> Array:
        eased = 0.5 - 0.5 * np.cos(np.pi * share)
        air = self._lift_off + eased[..., None] * (landing - self._lift_off)
        air[..., 2] += self._conf.lift_m * np.sin(np.pi * share)
        return air
