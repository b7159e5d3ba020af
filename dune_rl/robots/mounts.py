"""Default poses of the sensors on a robot."""

from pydantic import Field

from dune_rl.core.settings import Settings

Triple = tuple[float, float, float]


class MountsConf(Settings):
    """Positions of the sensors in the robot's frame [m]: scanners and depth strip, camera, and IMU.

    They apply to sensors whose own `mount_b` is null. `camera_pitch_deg` is the downward tilt of the camera.
    """

    scanner_b: Triple = Field((0.174, 0.0, 0.196), description="place of LiDARs and depth strip [m]")
    camera_b: Triple = Field((0.2, 0.0, 0.175), description="place of cameras [m]")
    camera_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    imu_b: Triple = Field((0.0, 0.0, 0.096), description="place of the IMU [m]")
