"""Which sensors a rover carries, and what they give."""

from typing import Literal

from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.settings import Settings

SensorName = Literal["lidar", "imu", "goal", "velocity"]


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings."""

    enabled: tuple[SensorName, ...] = ("lidar", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    imu: ImuConf = ImuConf()
