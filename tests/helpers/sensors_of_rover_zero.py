"""Settings of sensors at the mounts of rover_zero."""

from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.depth_strip import DepthStripConf
from dune_rl.sensors.height_scan import HeightScanConf
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf

MOUNTS = RoverZeroConf().mounts


def lidar_conf(**settings: object) -> LidarConf:
    return LidarConf(**{"mount_b": MOUNTS.scanner_b, **settings})


def lidar_3d_conf(**settings: object) -> Lidar3dConf:
    return Lidar3dConf(**{"mount_b": MOUNTS.scanner_b, **settings})


def depth_strip_conf(**settings: object) -> DepthStripConf:
    return DepthStripConf(**{"mount_b": MOUNTS.scanner_b, **settings})


def camera_conf(**settings: object) -> CameraConf:
    return CameraConf(**{"mount_b": MOUNTS.camera_b, "pitch_deg": MOUNTS.camera_pitch_deg, **settings})


def imu_conf(**settings: object) -> ImuConf:
    return ImuConf(**{"mount_b": MOUNTS.imu_b, **settings})


def height_scan_conf(**settings: object) -> HeightScanConf:
    return HeightScanConf(**{"standing_height_m": RoverZero.description.standing_height_m, **settings})
