"""Incremental encoders on the wheels: how far each has turned, in whole counts."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.pipeline import EncoderRealismConf
from dune_rl.sensors.sensor import VectorSensor, joints_of
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class EncodersConf(SensorSettings):
    """Counts in a turn of the wheel, and the fastest that is counted; 0 counts is an encoder without steps.

    The default is what a six-step Hall sensor gives through the gears of the
    Rover Zero: its maker's driver (RoverRobotics/librover, protocol_zero_2.hpp)
    takes 96 * 2 electrical turns of the motor for one of the wheel.
    """

    sensor: Literal["encoders"] = "encoders"
    realism: EncoderRealismConf | None = None
    counts_per_turn: int = Field(
        1152, ge=0, le=10_000_000, description="counts in a turn of the wheel; 0: an encoder without steps"
    )
    max_speed_radps: float = Field(
        100.0, gt=0.0, le=10_000.0, description="readings are clipped to this [rad/s]; odometry counts alike"
    )


class WheelCounter:
    """How far the W wheels of M rovers turn from one control step to the next, as encoders tell it.

    Counts are whole since the start of the episode, so that what one step rounds away the next one brings.
    """

    def __init__(self, conf: EncodersConf, num_rows: int, num_wheels: int, step_s: float) -> None:
        # An encoder without steps counts radians.
        self._count_rad = 2 * np.pi / conf.counts_per_turn if conf.counts_per_turn else 1.0
        self._whole = conf.counts_per_turn > 0
        self.most_rad = conf.max_speed_radps * step_s
        self._start = np.zeros((num_rows, num_wheels))
        self._counts = np.zeros((num_rows, num_wheels))

    def begin(self, mask: Flags, angle: Array) -> None:
        """Count from `angle` (M, J) [rad] in the scenes in `mask` (M,); the wheels are the first joints."""
        self._start[mask] = angle[mask, : self._start.shape[1]]
        self._counts[mask] = 0.0

    def turned(self, angle: Array) -> Array:
        """Turn of each wheel to `angle` (M, J) since the last call [rad], (M, W); at most `most_rad`."""
        counts = (angle[:, : self._start.shape[1]] - self._start) / self._count_rad
        if self._whole:
            counts = np.rint(counts)
        turned = (counts - self._counts) * self._count_rad
        self._counts = counts
        return clip(turned, -self.most_rad, self.most_rad)


class Encoders(VectorSensor):
    """The reading "encoders", (M, 2 * W): how far each wheel has turned in the last control step, and speeds.

    Turns [rad] come first; the speeds [rad/s] after them are those turns by the
    length of a step. Wheels are in the order of the robot's drive joints.
    """

    needs_joints: ClassVar[bool] = True

    def __init__(self, name: str, context: SensorContext, conf: EncodersConf) -> None:
        num_rows, num_wheels, step_s = context.num_rows, context.carrier.num_joints, context.step_s
        self._counter = WheelCounter(conf, num_rows, num_wheels, step_s)
        self._step_s = step_s
        most = self._counter.most_rad
        highest = np.repeat([most, most / step_s], num_wheels).astype(np.float32)
        super().__init__(name, num_rows, -highest, highest)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Nothing has turned in the scenes in `mask` (M,)."""
        self._counter.begin(mask, joints_of(now).angle)
        self._reading[mask] = 0.0

    def measure(self, now: GroupState, state: State) -> None:
        """Count the control step that has just ended."""
        turned = self._counter.turned(joints_of(now).angle)
        self._reading = np.concatenate([turned, turned / self._step_s], axis=1).astype(np.float32)
