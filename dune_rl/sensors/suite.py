"""Which sensors a rover carries, and what they give."""

from typing import Literal

from pydantic import Field

from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.settings import Settings

SensorName = Literal["lidar", "lidar_past", "lidar_rate", "imu", "goal", "velocity"]


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, and `lidar_rate` the change of
    each LiDAR value since then [m/s], clipped to `max_rate_mps`: one scan
    cannot tell what moves.
    """

    enabled: tuple[SensorName, ...] = ("lidar", "lidar_past", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    past_s: float = Field(0.3, gt=0.0, le=5.0)
    max_rate_mps: float = Field(3.0, gt=0.0, le=100.0)
    imu: ImuConf = ImuConf()
