"""The driver `dwa`: the dynamic window approach over what the robot has seen."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.command_grid import CommandGridConf, command_grid
from dune_rl.state.state import GroupState, State


class Dwa(BoundBehaviour):
    """Drives N bodies by the cheapest command of the reading `sensor`, of the sensor `command_costs`.

    It knows what that sensor is made of: the LiDAR, tracks of what moves, the map of what was seen, low
    obstacles, the goal and the odometry. It is what a policy with `learning.prior` is before it has learnt.
    Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance" (1997). `commands` are those
    of the sensor.
    """

    reads_sensors = True

    def __init__(
        self,
        num_rows: int,
        *,
        sensor: Annotated[str, Field(description="name of the sensor command_costs")] = "command_costs",
        commands: Annotated[CommandGridConf, Field(description="as those of the sensor")] = CommandGridConf(),  # noqa: B008
    ) -> None:
        self._sensor, self._conf = sensor, commands

    def bind(self, context: DriverContext) -> None:
        """Take the grid of commands; raises ConfigError without their costs, or with another grid's."""
        super().bind(context)
        vehicle = context.vehicle
        self._commands = command_grid(self._conf, vehicle.min_speed_mps, vehicle.max_speed_mps)
        costs = context.observe().get(self._sensor)
        if costs is None:
            raise ConfigError(
                f"dwa cannot act for the group {context.group}: it needs the sensor {self._sensor}; add "
                f"sensors=perception '+sensors.{self._sensor}={{sensor: command_costs}}'"
            )
        if costs.shape[1] != len(self._commands):
            raise ConfigError(
                f"dwa has {len(self._commands)} commands, and the sensor {self._sensor} costs of "
                f"{costs.shape[1]}; give both the same commands"
            )

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Do nothing: the sensor remembers, and forgets by itself."""

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad], by the readings alone."""
        costs = self.context.observe()[self._sensor]
        found: Array = self._commands[np.argmin(costs, axis=1)]
        return found
