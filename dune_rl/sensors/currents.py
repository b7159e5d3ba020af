"""Motor currents: what the drives' torques cost, wheel by wheel."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.geometry.frames import clip
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.realism.pipeline import ReadingRealismConf
from dune_rl.sensors.sensor import VectorSensor, joints_of
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class CurrentsConf(SensorSettings):
    """Motor and gear of a wheel. The defaults stand for the Rover Zero's and are estimates.

    The gear's 96 is that of its maker's driver (RoverRobotics/librover,
    protocol_zero_2.hpp: 96 * 2 electrical turns for one of the wheel, two a turn
    of the motor). The torque constant follows from the 17,000 electrical turns
    a minute that the driver allows: 8,500 rpm at some 15 V are 570 rpm/V, and
    9.55 / 570 = 0.017 N m/A. Efficiency and limit are usual for such gears and
    motor controllers.
    """

    # An estimate: a hundredth of the current that motors may draw.
    default_realism: ClassVar = ReadingRealismConf(each=NoiseConf(noise=0.1))

    sensor: Literal["currents"] = "currents"
    torque_constant_nm_per_a: float = Field(0.017, gt=0.0, le=10.0, description="of the motor [N m/A]")
    gear_ratio: float = Field(96.0, gt=0.0, le=1_000.0, description="turns of the motor for one of the wheel")
    efficiency: float = Field(0.7, gt=0.0, le=1.0, description="share of the torque that the gears leave")
    limit_a: float = Field(10.0, gt=0.0, le=1_000.0, description="readings are clipped to this [A]")


class Currents(VectorSensor):
    """The reading "currents", (M, W) [A], clipped to ± `limit_a`: positive where the torque is forward.

    Losses in the gears take torque from a motor that drives its wheel, and hold
    a wheel that would drive its motor. The torque is that of the last physics
    step; the motor's own inertia and its current without load are left out.
    """

    needs_joints: ClassVar[bool] = True

    def __init__(self, name: str, context: SensorContext, conf: CurrentsConf) -> None:
        num_wheels = context.carrier.num_joints
        self._driving_a_per_nm = 1.0 / (conf.torque_constant_nm_per_a * conf.gear_ratio * conf.efficiency)
        self._driven_a_per_nm = self._driving_a_per_nm * conf.efficiency**2
        # Rounded, so that what is clipped stays within bounds that are float32.
        self._limit_a = float(np.float32(conf.limit_a))
        self._num_wheels = num_wheels
        highest = np.full(num_wheels, self._limit_a, np.float32)
        super().__init__(name, context.num_rows, -highest, highest)

    def measure(self, now: GroupState, state: State) -> None:
        """Take the present torques."""
        joints, wheels = joints_of(now), self._num_wheels
        torque = joints.torque[:, :wheels]
        driving = torque * joints.speed[:, :wheels] > 0.0
        current = torque * np.where(driving, self._driving_a_per_nm, self._driven_a_per_nm)
        self._reading = clip(current, -self._limit_a, self._limit_a).astype(np.float32)
