"""The sensors there are: ours, those of installed packages, and those that a program registers."""

from typing import Any

import numpy as np

from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import Registry
from dune_rl.core.signatures import PartSignature
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.function_sensor import FunctionSensor, ReadingBounds
from dune_rl.sensors.sensor import Sensor
from dune_rl.sensors.settings import SensorSettings

_OWN = {
    "camera": "camera_sensor:CameraSensor",
    "currents": "currents:Currents",
    "depth_strip": "depth_strip:DepthStrip",
    "encoders": "encoders:Encoders",
    "goal": "goal:Goal",
    "height_scan": "height_scan:HeightScan",
    "imu": "imu:ImuSensor",
    "lidar": "lidar_sensor:LidarSensor",
    "lidar_3d": "lidar_3d:Lidar3d",
    "lidar_past": "lidar_sensor:LidarPast",
    "nearest_agent": "nearest_agent:NearestAgent",
    "neighbours": "neighbours:Neighbours",
    "odometry": "odometry:Odometry",
    "planar_velocity": "velocity:PlanarVelocity",
    "position": "position:Position",
    "velocity": "velocity:Velocity",
}


class SensorRegistry(Registry[Sensor]):
    """Sensors are functions `f(state, group, *, SETTINGS) -> (N, size)` with `sensor_bounds`, and classes.

    A class has `__init__(self, name, context, *, SETTINGS)` and the methods of the `Sensor` protocol; `name`
    is that of its readings, or what their names begin with, and `context` is a `SensorContext`.
    """

    def __init__(self) -> None:
        super().__init__(
            "sensor",
            "dune_rl.sensors.registry:SENSORS",
            own={name: f"dune_rl.sensors.{path}" for name, path in _OWN.items()},
            base=SensorSettings,
            product=Sensor,
            returned=np.ndarray,
            form="a function of (state, group) that returns an array, or a class made with (name, context)",
            function_leading=("state", "group"),
            class_leading=("name", "context"),
            tag="sensor",
        )

    def build_sensor(self, conf: SensorSettings, name: str, context: SensorContext) -> Sensor:
        """The sensor `name` of these settings, without rate, latency and noise."""
        part = self.part_of(conf)
        if part.signature.is_class:
            return self.build(conf, name, context)
        bounds: ReadingBounds = part.target.sensor_bounds  # type: ignore[attr-defined]
        params = part.signature.arguments(conf)
        return FunctionSensor(name, part.target, context.num_rows, bounds, params, part.origin)

    def _signature_of(self, target: Any, name: str, origin: str) -> PartSignature:
        signature = super()._signature_of(target, name, origin)
        if not signature.is_class and not hasattr(target, "sensor_bounds"):
            raise RegistryError(
                f"{origin}, whose values have no bounds: write "
                "@dune_rl.sensor_bounds(low=..., high=..., size=...) over it."
            )
        return signature


SENSORS = SensorRegistry()
