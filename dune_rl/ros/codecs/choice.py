"""Which codec each sensor of a robot has."""

from collections.abc import Mapping

from dune_rl.ros.codecs.codec import ArrayCodec, SensorCodec
from dune_rl.ros.codecs.motion import GoalCodec, ImuCodec, OdometryCodec, VelocityCodec
from dune_rl.ros.codecs.pictures import CameraCodec
from dune_rl.ros.codecs.scans import CloudCodec, ScanCodec
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.own_motion import GoalConf, VelocityConf
from dune_rl.sensors.sensor import Bounds
from dune_rl.sensors.settings import SensorSettings
from dune_rl.sensors.wheels import OdometryConf


def make_codec(
    name: str, conf: SensorSettings, bounds: Mapping[str, Bounds], *, step_s: float, standard: bool = True
) -> SensorCodec:
    """The codec of the sensor `name`, whose readings have `bounds`; arrays where not `standard`."""
    if standard:
        match conf:
            case LidarConf():
                every, _ = conf.steps(step_s)
                return ScanCodec(name, conf, every * step_s)
            case Lidar3dConf() if "range" in conf.outputs:
                return CloudCodec(name, conf)
            case CameraConf():
                return CameraCodec(name, conf)
            case ImuConf():
                return ImuCodec(name, conf)
            case OdometryConf():
                return OdometryCodec(name)
            case VelocityConf():
                return VelocityCodec(name)
            case GoalConf():
                return GoalCodec(name)
    return ArrayCodec({reading: (low.shape, low.dtype) for reading, (low, _) in bounds.items()})
