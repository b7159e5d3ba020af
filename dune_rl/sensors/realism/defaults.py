"""The parts that sensors have, once any has the realism of one: no channel is left perfect by accident."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.realism.pipeline import (
    ImuRealismConf,
    PositionRealismConf,
    ReadingRealismConf,
    RealismConf,
    SpeedRealismConf,
)
from dune_rl.sensors.realism.presets import PARTS

# By kind of sensor. Encoders and odometry are missing: they count whole steps and know nothing of slip.
# Goal and velocity are missing: they are computed from other readings.
_DEFAULTS: Mapping[str, tuple[type[RealismConf], Any]] = {
    "imu": (ImuRealismConf, "bno055"),
    "lidar": (LidarRealismConf, "rplidar_a2m8"),
    "lidar_3d": (LidarRealismConf, "velodyne_vlp16"),
    "camera": (
        CameraRealismConf,
        {**PARTS["realsense_d435"].settings, **PARTS["raspberry_pi_v2"].settings},
    ),
    "position": (PositionRealismConf, "zed_f9p"),
    # Estimates: two centimetres of depth and height, and a hundredth of the current that motors may draw.
    "depth_strip": (ReadingRealismConf, {"each": {"noise": 0.02}}),
    "height_scan": (ReadingRealismConf, {"each": {"noise": 0.02}}),
    "currents": (ReadingRealismConf, {"each": {"noise": 0.1}}),
    "planar_velocity": (ReadingRealismConf, {"each": {"noise": 0.05}}),
    "neighbours": (ReadingRealismConf, {"each": {"noise": 0.05}}),
    "nearest_agent": (ReadingRealismConf, {"each": {"noise": 0.05}}),
}
# What a body without wheels knows of its speed, by the motion of its legs; an estimate.
LEG_SPEED = SpeedRealismConf.model_validate({"forward": {"noise": 0.05, "bias": 0.02}})


@lru_cache(maxsize=64)
def default_realism(kind: str, step_s: float) -> RealismConf | None:
    """The part that a sensor of this kind has by default, at a rate that control steps of `step_s` allow.

    None where the sensor has its faults by itself, is computed from other readings, or is a user's own.
    """
    if kind not in _DEFAULTS:
        return None
    conf, settings = _DEFAULTS[kind]
    return conf.model_validate(settings).fit_to(step_s)
