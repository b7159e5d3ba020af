"""Which sensors a rover carries, and what they give."""

from typing import Literal

from pydantic import Field

from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.settings import Settings

SensorName = Literal["lidar", "lidar_past", "imu", "goal", "velocity"]


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, carried into the present sensor
    frame: where it differs from the present scan, something has moved.
    """

    enabled: tuple[SensorName, ...] = ("lidar", "lidar_past", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    past_s: float = Field(0.5, gt=0.0, le=5.0)
    imu: ImuConf = ImuConf()
