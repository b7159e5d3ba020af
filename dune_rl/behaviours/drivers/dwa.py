"""The driver `dwa`: the dynamic window approach over what the robot has seen."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.sensors.perception.command_costs import CommandCostsConf
from dune_rl.state.command_grid import command_grid
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
        """Take the sensor's commands; raises ConfigError without it."""
        super().bind(context)
        conf, vehicle = context.sensors.get(self._sensor), context.vehicle
        if not isinstance(conf, CommandCostsConf):
            raise ConfigError(
                f"dwa cannot act for the group {context.group}: it needs the sensor {self._sensor}; add "
                f"sensors=perception '+sensors.{self._sensor}={{sensor: command_costs}}'"
            )
        self._commands = command_grid(conf.commands, vehicle.min_speed_mps, vehicle.max_speed_mps)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Do nothing: the sensor remembers, and forgets by itself."""

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad], by the readings alone."""
        costs = self.context.observe()[self._sensor]
        found: Array = self._commands[np.argmin(costs, axis=1)]
        return found
