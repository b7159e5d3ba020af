"""Settings that robots have in common: the base of their settings, sensor mounts and battery."""

from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array

Triple = tuple[float, float, float]

_JOULES_PER_WH = 3600.0


class RobotSettings(Settings):
    """Settings of a robot; `name` selects the settings class when a file is read."""

    name: str

    @property
    def standing_height_m(self) -> float | None:
        """Height of the origin over level ground, where it is known before the robot is built."""
        return None


class MountsConf(Settings):
    """Positions of the sensors in the robot's frame [m]: scanners and depth strip, camera, and IMU.

    They apply to sensors whose own `mount_b` is null. `camera_pitch_deg` is the downward tilt of the camera.
    """

    scanner_b: Triple = Field((0.174, 0.0, 0.196), description="place of LiDARs and depth strip [m]")
    camera_b: Triple = Field((0.2, 0.0, 0.175), description="place of cameras [m]")
    camera_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    imu_b: Triple = Field((0.0, 0.0, 0.096), description="place of the IMU [m]")


class BatteryConf(Settings):
    """Capacity, power at rest, and efficiency of the motors: mechanical over electrical work.

    Braking recovers nothing.
    """

    capacity_wh: float = Field(gt=0.0, description="energy of a full battery [W h]")
    idle_w: float = Field(10.0, ge=0.0)
    efficiency: float = Field(0.7, gt=0.0, le=1.0)

    def drawn_wh(self, work_j: Array, time_s: float) -> Array:
        """Energy drawn [W h], (N,), in `time_s` in which the motors do mechanical work `work_j` (N,) [J]."""
        return (self.idle_w * time_s + work_j / self.efficiency) / _JOULES_PER_WH
