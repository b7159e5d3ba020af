"""An inertial measurement unit: accelerometer with gravity, gyroscope, orientation."""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import cross
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.pipeline import ImuRealismConf
from dune_rl.sensors.sensor import MOUNT, PI32, Mount, VectorSensor, mount_position
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# Index of the yaw in a reading.
YAW = 8


class ImuConf(SensorSettings):
    """Mount and ranges; readings beyond a range are clipped, as the part itself does."""

    from_carrier: ClassVar = {"mount_b": "imu_b"}
    default_realism: ClassVar = ImuRealismConf.model_validate("bno055")

    sensor: Literal["imu"] = "imu"
    realism: ImuRealismConf | None = None
    acceleration_range_mps2: float = Field(156.9, gt=GRAVITY_MPS2, description="clips readings [m/s²]")
    angular_range_radps: float = Field(34.9, gt=0.0, description="clips readings [rad/s]")
    mount_b: Mount = MOUNT


class ImuSensor(VectorSensor):
    """The reading `name`, (N, 9): specific force [m/s²], angular velocity [rad/s], and roll, pitch, yaw.

    Angles are in [rad], all else in the body frame. At rest on level ground it reads (0, 0, +9.81) first.
    `acceleration_b` (N, 3) [m/s²], without gravity, is the change of the mount's velocity over the last
    control step: the mean of what the unit felt during it.
    """

    def __init__(self, name: str, context: SensorContext, conf: ImuConf) -> None:
        self._limits = conf.acceleration_range_mps2, conf.angular_range_radps
        high = np.repeat([*self._limits, PI32], 3)
        super().__init__(name, context.num_rows, -high, high)
        self._mount, self._step_s = mount_position(conf.mount_b), context.step_s
        self._velocity_w, self.acceleration_b = np.zeros((2, context.num_rows, 3))

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Start the episodes in `mask` (N,) from the present motion, unaccelerated."""
        motion = now.motion
        velocity_w = motion.velocity_w + cross(motion.angular_w, motion.rotation @ self._mount)
        self._velocity_w = np.where(mask[:, None], velocity_w, self._velocity_w)
        self.acceleration_b = np.where(mask[:, None], 0.0, self.acceleration_b)
        self._take(now)

    def measure(self, now: GroupState, state: State) -> None:
        motion, before = now.motion, self._velocity_w
        self._velocity_w, self.acceleration_b = np.empty((2, *before.shape))
        _accelerate(
            motion.rotation, motion.velocity_w, motion.angular_w, self._mount, self._step_s, before,
            self._velocity_w, self.acceleration_b,
        )  # fmt: skip
        self._take(now)

    def _take(self, now: GroupState) -> None:
        motion, reading = now.motion, np.empty_like(self._reading)
        _take_reading(
            self.acceleration_b,
            motion.rotation,
            motion.angular_b,
            motion.roll_pitch_yaw,
            self._limits,
            reading,
        )
        self._reading = reading


class Imu6AxisConf(SensorSettings):
    """An inertial measurement unit without a compass has nothing to set: its readings are those of `imu`."""

    sensor: Literal["imu_6axis"] = "imu_6axis"
    realism: None = Field(None, description="none of its own: that of the sensor imu")


class Imu6Axis(VectorSensor):
    """The reading `name`, (N, 8): specific force [m/s²], angular velocity [rad/s], roll and pitch [rad].

    It is the reading of the sensor imu without the yaw, by which policies would learn where north is.
    """

    def __init__(self, name: str, context: SensorContext, conf: Imu6AxisConf) -> None:
        limits = context.settings_of("imu")
        high = np.repeat([limits.acceleration_range_mps2, limits.angular_range_radps, PI32], 3)[:YAW]
        super().__init__(name, context.num_rows, -high, high)
        self._imu = context.reading_of("imu")

    def measure(self, now: GroupState, state: State) -> None:
        self._store(self._imu()[:, :YAW])


@compile_function
def _accelerate(
    rotation: Any, velocity_w: Any, angular_w: Any, mount: Any, step_s: float, before: Any, velocity: Any,
    acceleration: Any,
) -> None:  # fmt: skip
    # Of the mount: v + omega x (R mount), and the change of that in the body frame.
    x, y, z = mount
    for row in range(len(rotation)):
        arm_x = rotation[row, 0, 0] * x + rotation[row, 0, 1] * y + rotation[row, 0, 2] * z
        arm_y = rotation[row, 1, 0] * x + rotation[row, 1, 1] * y + rotation[row, 1, 2] * z
        arm_z = rotation[row, 2, 0] * x + rotation[row, 2, 1] * y + rotation[row, 2, 2] * z
        turn_x, turn_y, turn_z = angular_w[row, 0], angular_w[row, 1], angular_w[row, 2]
        velocity[row, 0] = velocity_w[row, 0] + (turn_y * arm_z - turn_z * arm_y)
        velocity[row, 1] = velocity_w[row, 1] + (turn_z * arm_x - turn_x * arm_z)
        velocity[row, 2] = velocity_w[row, 2] + (turn_x * arm_y - turn_y * arm_x)
        for axis in range(3):
            felt = 0.0
            for world in range(3):
                felt += rotation[row, world, axis] * ((velocity[row, world] - before[row, world]) / step_s)
            acceleration[row, axis] = felt


@compile_function
def _take_reading(
    acceleration: Any, rotation: Any, angular_b: Any, angles: Any, limits: Any, found: Any
) -> None:
    most_acceleration, most_turn = limits
    for row in range(len(found)):
        for axis in range(3):
            force = acceleration[row, axis] + GRAVITY_MPS2 * rotation[row, 2, axis]
            found[row, axis] = min(max(force, -most_acceleration), most_acceleration)
            found[row, 3 + axis] = min(max(angular_b[row, axis], -most_turn), most_turn)
            found[row, 6 + axis] = angles[row, axis]
