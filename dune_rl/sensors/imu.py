"""An inertial measurement unit: accelerometer with gravity, gyroscope, orientation."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import clip, cross, to_body
from dune_rl.sensors.sensor import PI32, Bounds, Flags, Mount, Reading, mount_position
from dune_rl.settings import Settings
from dune_rl.state import GroupState, State

Array = NDArray[np.float64]
GRAVITY_MPS2 = 9.81


class ImuConf(Settings):
    """Mount and ranges; readings beyond a range are clipped, as the part itself does."""

    acceleration_range_mps2: float = Field(156.9, gt=GRAVITY_MPS2)
    angular_range_radps: float = Field(34.9, gt=0.0)
    mount_b: Mount = None


class Imu:
    """Readings of M units.

    The acceleration is the change of the mount's velocity over the last
    control step, the mean of what the unit felt during it.
    """

    def __init__(self, conf: ImuConf, num_rows: int) -> None:
        self.conf = conf
        self._previous_velocity = np.zeros((num_rows, 3))
        self.acceleration_b = np.zeros((num_rows, 3))
        self._mount = mount_position(conf.mount_b)

    def begin(self, mask: NDArray[np.bool_], rotation: Array, velocity_w: Array, angular_w: Array) -> None:
        """Start from the present motion, unaccelerated, in the scenes in `mask` (M,)."""
        velocity = self._mount_velocity(rotation, velocity_w, angular_w)
        self._previous_velocity = np.where(mask[:, None], velocity, self._previous_velocity)
        self.acceleration_b = np.where(mask[:, None], 0.0, self.acceleration_b)

    def _mount_velocity(self, rotation: Array, velocity_w: Array, angular_w: Array) -> Array:
        return velocity_w + cross(angular_w, rotation @ self._mount)

    def measure(self, rotation: Array, velocity_w: Array, angular_w: Array, step_s: float) -> Array:
        """Acceleration without gravity in the body frame [m/s²], (M, 3), over the last `step_s`.

        `rotation` (M, 3, 3); `velocity_w` and `angular_w` (M, 3) are the
        body's. Call it once per control step: it keeps the velocity.
        """
        velocity = self._mount_velocity(rotation, velocity_w, angular_w)
        acceleration_w = (velocity - self._previous_velocity) / step_s
        self._previous_velocity = velocity
        self.acceleration_b = to_body(rotation, acceleration_w)
        return self.acceleration_b

    def reading(self, rotation: Array, angular_b: Array, roll_pitch_yaw: Array) -> NDArray[np.float32]:
        """Specific force [m/s²], angular velocity [rad/s], and roll, pitch, yaw [rad], body frame, (M, 9).

        At rest on level ground the accelerometer reads (0, 0, +9.81).
        """
        conf = self.conf
        out = np.empty((len(rotation), 9), np.float32)
        force = self.acceleration_b + GRAVITY_MPS2 * rotation[:, 2, :]
        out[:, 0:3] = clip(force, -conf.acceleration_range_mps2, conf.acceleration_range_mps2)
        out[:, 3:6] = clip(angular_b, -conf.angular_range_radps, conf.angular_range_radps)
        out[:, 6:9] = roll_pitch_yaw
        return out


class ImuSensor:
    """The reading `name`, (N, 9): specific force, angular velocity and attitude; see `Imu.reading`."""

    def __init__(self, conf: ImuConf, num_rows: int, step_s: float, name: str = "imu") -> None:
        self._imu, self._name = Imu(conf, num_rows), name
        self._step_s = step_s
        self._reading = np.zeros((num_rows, 9), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """The unit's ranges, and whole turns."""
        conf = self._imu.conf
        ranges = [conf.acceleration_range_mps2] * 3 + [conf.angular_range_radps] * 3 + [PI32] * 3
        high = np.array(ranges, np.float32)
        return {self._name: (-high, high)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Start the episodes in `mask` (M,) unaccelerated."""
        self._imu.begin(mask, now.motion.rotation, now.motion.velocity_w, now.motion.angular_w)
        self._take(now)

    def measure(self, now: GroupState, state: State) -> None:
        """Measure the control step that has just ended."""
        self._imu.measure(now.motion.rotation, now.motion.velocity_w, now.motion.angular_w, self._step_s)
        self._take(now)

    def _take(self, now: GroupState) -> None:
        self._reading = self._imu.reading(
            now.motion.rotation, now.motion.angular_b, now.motion.roll_pitch_yaw
        )

    def read(self) -> dict[str, Reading]:
        """The latest measurement."""
        return {self._name: self._reading.copy()}
