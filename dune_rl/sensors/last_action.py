"""The sensor of what an agent was commanded last."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.sensor import VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State


class LastActionConf(SensorSettings):
    """The last action has nothing to set: a robot knows its commands without faults."""

    sensor: Literal["last_action"] = "last_action"
    realism: None = Field(None, description="none: a robot knows what it was commanded")


class LastAction(VectorSensor):
    """The reading `name`, (N, A): the action of the last control step, -1 at its lower bound, 1 at its upper.

    It is 0 at the start of an episode. Of an action that is held for several steps it is that action.
    """

    def __init__(self, name: str, context: SensorContext, conf: LastActionConf) -> None:
        highest = np.ones(context.action_size)
        super().__init__(name, context.num_rows, -highest, highest)

    def measure(self, now: GroupState, state: State) -> None:
        if now.last_action is not None:
            self._store(now.last_action)
