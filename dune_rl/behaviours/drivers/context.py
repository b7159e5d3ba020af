"""What a driver may know of the body that it drives: its model, the LiDAR, and the readings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.sensor import Reading, Sensor
from dune_rl.state.unicycle import Unicycle

# Of a time step [s] and a number of steps T: places (N, K, T, 2) [m], NaN of neighbours whose ways are not
# fixed.
Forecast = Callable[[float, int], Array]


def _no_sensors(name: str) -> Sensor | None:
    return None


@dataclass(frozen=True)
class DriverContext:
    """The driven group, called `group`: its vehicle model, its LiDAR if it has one, its readings.

    `lidar` has the mount that the body gives it. `observe` returns the latest readings by name, each of
    shape (N, ...). `forecast`, where there is one, returns where the neighbours will be. `sensor_of` returns
    the sensor of a name, or None.
    """

    group: str
    vehicle: Unicycle
    lidar: LidarConf | None
    observe: Callable[[], dict[str, Reading]]
    forecast: Forecast | None = None
    sensor_of: Callable[[str], Sensor | None] = _no_sensors

    def require_lidar(self, names: Sequence[str], who: str) -> LidarConf:
        """The LiDAR; raises ConfigError, that `who` cannot act, without it or one of the readings `names`."""
        readings = self.observe()
        missing = [name for name in names if name not in readings]
        if missing or self.lidar is None:
            needed = f"{', '.join(names[:-1])} and {names[-1]}"
            raise ConfigError(
                f"{who} cannot act for the group {self.group}: it needs the sensors {needed}, and has no "
                f"{' and no '.join(missing) or 'lidar'}; add to its sensors what sensors=default has"
            )
        return self.lidar


class BoundBehaviour:
    """Base of behaviours that need the context of the group that they drive; they are bound to it first."""

    _context: DriverContext | None = None

    def bind(self, context: DriverContext) -> None:
        """Take the context; raises ConfigError if it cannot drive there."""
        self._context = context

    @property
    def context(self) -> DriverContext:
        """The context of the driven group; raises ConfigError before `bind`."""
        if self._context is None:
            raise ConfigError("a behaviour must be bound to the group that it drives (`bind`) before it acts")
        return self._context
