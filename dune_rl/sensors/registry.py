"""The sensors there are: ours, those of installed packages, and those that a program registers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import Registry
from dune_rl.core.signatures import PartSignature
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.sensor import Sensor, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

_OWN = {
    "agent_tracks": "perception.agent_tracks:AgentTracks",
    "camera": "camera_sensor:CameraSensor",
    "command_costs": "perception.command_costs:CommandCosts",
    "currents": "wheels:Currents",
    "depth_strip": "depth_strip:DepthStrip",
    "encoders": "wheels:Encoders",
    "goal": "own_motion:Goal",
    "goal_direction": "own_motion:GoalDirection",
    "ground_profile": "ground_profile:GroundProfile",
    "height_scan": "height_scan:HeightScan",
    "imu": "imu:ImuSensor",
    "imu_6axis": "imu:Imu6Axis",
    "last_action": "last_action:LastAction",
    "lidar": "lidar:LidarSensor",
    "lidar_3d": "lidar_3d:Lidar3d",
    "lidar_past": "past_scan:LidarPast",
    "low_obstacles": "perception.low_obstacles:LowObstacles",
    "nearest_agent": "neighbours:NearestAgent",
    "neighbours": "neighbours:Neighbours",
    "odometry": "wheels:Odometry",
    "planar_velocity": "own_motion:PlanarVelocity",
    "position": "own_motion:Position",
    "velocity": "own_motion:Velocity",
    "way_left": "perception.way_left:WayLeft",
}


# f(state, group, *, params) -> (N, size) or, for a size of 1, (N,).
SensorFunction = Callable[..., NDArray[Any]]


@dataclass(frozen=True)
class ReadingBounds:
    """What `dune_rl.sensor_bounds` states: a reading's size, and the lowest and highest of its entries."""

    low: float | tuple[float, ...]
    high: float | tuple[float, ...]
    size: int = 1


class FunctionSensor(VectorSensor):
    """The reading `name`, (N, size): what `function(state, group, **params)` returns, clipped to `bounds`.

    Raises RegistryError, whose sentence opens with `origin`, where the function returns another shape or a
    value that is not a number.
    """

    def __init__(
        self,
        name: str,
        function: SensorFunction,
        num_rows: int,
        bounds: ReadingBounds,
        params: Mapping[str, Any],
        origin: str,
    ) -> None:
        low, high = (np.broadcast_to(end, (bounds.size,)) for end in (bounds.low, bounds.high))
        super().__init__(name, num_rows, low, high)
        if not (self._low <= self._high).all():
            raise RegistryError(f"{origin}, whose low {bounds.low} must be at most its high {bounds.high}.")
        self._function, self._params, self._origin = function, dict(params), origin

    def measure(self, now: GroupState, state: State) -> None:
        values = np.asarray(self._function(state, now, **self._params), np.float32)
        shape = self._reading.shape
        if values.shape != shape and not (shape[1] == 1 and values.shape == shape[:1]):
            raise RegistryError(
                f"{self._origin}, which must return an array of shape {shape}, a row for each agent, "
                f"and returned one of shape {values.shape}."
            )
        if np.isnan(values).any():
            raise RegistryError(f"{self._origin}, which returned NaN.")
        self._store(values.reshape(shape))


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
