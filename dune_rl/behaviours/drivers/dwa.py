"""The driver `dwa`: the dynamic window approach over what the robot has seen."""

from typing import Annotated

from pydantic import Field

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.sensors.perception.command_costs import CommandCosts
from dune_rl.state.state import GroupState, State


class Dwa(BoundBehaviour):
    """Drives N bodies by the cheapest command of a sensor `command_costs`, whose name is `sensor`.

    It knows what that sensor is made of: the LiDAR, tracks of what moves, the map of what was seen, low
    obstacles, the goal and the odometry. It is what a policy with `learning.prior` is before it has learnt.
    Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance" (1997).
    """

    reads_sensors = True

    def __init__(
        self,
        num_rows: int,
        *,
        sensor: Annotated[str, Field(description="name of the sensor command_costs")] = "command_costs",
    ) -> None:
        self._sensor = sensor

    def bind(self, context: DriverContext) -> None:
        """Take the sensor; raises ConfigError without it."""
        super().bind(context)
        self._costs = find_command_costs(context, self._sensor, "dwa")

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Do nothing: the sensor remembers, and forgets by itself."""

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad], by the readings alone."""
        found: Array = self._costs.actions[self._costs.read()[self._sensor].argmin(axis=1)]
        return found


def find_command_costs(context: DriverContext, sensor: str, who: str) -> CommandCosts:
    """The sensor of this name; raises ConfigError, that the driver `who` cannot act, without it."""
    found = context.sensor_of(sensor)
    if not isinstance(found, CommandCosts):
        raise ConfigError(
            f"{who} cannot act for the group {context.group}: it needs the sensor {sensor}; add "
            f"sensors=perception '+sensors.{sensor}={{sensor: command_costs}}'"
        )
    return found
