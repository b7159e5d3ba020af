"""An inertial measurement unit: accelerometer with gravity, gyroscope, orientation."""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import cross
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.realism.pipeline import ImuRealismConf
from dune_rl.sensors.sensor import MOUNT, PI32, Mount, VectorSensor, mount_position
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class ImuConf(SensorSettings):
    """Mount and ranges; readings beyond a range are clipped, as the part itself does."""

    from_carrier: ClassVar = {"mount_b": "imu_b"}
    default_realism: ClassVar = ImuRealismConf.model_validate("bno055")

    sensor: Literal["imu"] = "imu"
    realism: ImuRealismConf | None = None
    acceleration_range_mps2: float = Field(156.9, gt=GRAVITY_MPS2, description="clips readings [m/s²]")
    angular_range_radps: float = Field(34.9, gt=0.0, description="clips readings [rad/s]")
    mount_b: Mount = MOUNT


class Imu:
    """Measurements of N inertial units.

    The acceleration is the change of the mount's velocity over the last control step: the mean of what the
    unit felt during it.
    """

    def __init__(self, conf: ImuConf, num_rows: int) -> None:
        self.conf = conf
        self._previous_velocity = np.zeros((num_rows, 3))
        self.acceleration_b = np.zeros((num_rows, 3))
        self._mount = mount_position(conf.mount_b)

    def begin(self, mask: Flags, rotation: Array, velocity_w: Array, angular_w: Array) -> None:
        """Start from the present motion, unaccelerated, in the scenes in `mask` (M,)."""
        velocity = velocity_w + cross(angular_w, rotation @ self._mount)
        self._previous_velocity = np.where(mask[:, None], velocity, self._previous_velocity)
        self.acceleration_b = np.where(mask[:, None], 0.0, self.acceleration_b)

    def measure(self, rotation: Array, velocity_w: Array, angular_w: Array, step_s: float) -> Array:
        """Acceleration without gravity in the body frame [m/s²], (M, 3), over the last `step_s`.

        `rotation` (M, 3, 3); `velocity_w` and `angular_w` (M, 3) are the
        body's. Call it once per control step: it keeps the velocity.
        """
        velocity, self.acceleration_b = np.empty_like(self._previous_velocity), np.empty((len(rotation), 3))
        _accelerate(
            rotation, velocity_w, angular_w, self._mount, step_s, self._previous_velocity, velocity,
            self.acceleration_b,
        )  # fmt: skip
        self._previous_velocity = velocity
        return self.acceleration_b

    def reading(self, rotation: Array, angular_b: Array, roll_pitch_yaw: Array) -> Floats:
        """Specific force [m/s²], angular velocity [rad/s], and roll, pitch, yaw [rad], body frame, (M, 9).

        At rest on level ground the accelerometer reads (0, 0, +9.81).
        """
        conf = self.conf
        out = np.empty((len(rotation), 9), np.float32)
        limits = conf.acceleration_range_mps2, conf.angular_range_radps
        _take_reading(self.acceleration_b, rotation, angular_b, roll_pitch_yaw, limits, out)
        return out


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


class ImuSensor(VectorSensor):
    """The reading `name`, (N, 9): specific force, angular velocity and attitude; see `Imu.reading`."""

    def __init__(self, name: str, context: SensorContext, conf: ImuConf) -> None:
        self._imu, self._step_s = Imu(conf, context.num_rows), context.step_s
        ranges = [conf.acceleration_range_mps2] * 3 + [conf.angular_range_radps] * 3 + [PI32] * 3
        high = np.array(ranges, np.float32)
        super().__init__(name, context.num_rows, -high, high)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Start the episodes in `mask` (M,) unaccelerated."""
        self._imu.begin(mask, now.motion.rotation, now.motion.velocity_w, now.motion.angular_w)
        self._take(now)

    def measure(self, now: GroupState, state: State) -> None:
        self._imu.measure(now.motion.rotation, now.motion.velocity_w, now.motion.angular_w, self._step_s)
        self._take(now)

    def _take(self, now: GroupState) -> None:
        self._reading = self._imu.reading(
            now.motion.rotation, now.motion.angular_b, now.motion.roll_pitch_yaw
        )
