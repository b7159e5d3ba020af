"""The behaviour `orca`: people who keep clear of each other by ORCA, with a reaction to robots."""

import numpy as np

from dune_rl.behaviours.destinations import Destinations, DestinedBehaviour
from dune_rl.behaviours.ranges import PauseRange, Places, Range, Speed
from dune_rl.behaviours.reactions import Notice, Reaction, Reactions
from dune_rl.geometry.arrays import Array
from dune_rl.state.state import GroupState, State

# Time over which what pushes a scared person acts [s].
_PUSHED_S = 0.5


class Orca(DestinedBehaviour):
    """People who go to `places`, or random ones, past everybody; see `orca_loops`.

    `reaction` is how they react to robots that they notice within `notice_m`; see `reactions`. Regular people
    count on the robot to make half of the way for them; impassive ones, for whom it is an obstacle, do not.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        reaction: Reaction = "regular",
        notice_m: Notice = 4.0,
        speed_mps: Speed = 1.0,
        places: Places = (),
        range_m: Range = 8.0,
        pause_s: PauseRange = (0.0, 3.0),
    ) -> None:
        places_w = np.array(places, float).reshape(-1, 2)
        super().__init__(num_rows, speed_mps, Destinations(num_rows, "orca", places_w, range_m, pause_s))
        self._reactions = Reactions(num_rows, reaction, notice_m)
        self.robots_share = 1.0 if reaction == "impassive" else self.robots_share

    def want(self, state: State, group: GroupState) -> Array:
        """To the target of the reaction, and away from what scares."""
        target, pauses = self.targets(state, group)
        speed = np.where(pauses, 0.0, self._speed_mps)
        response = self._reactions.respond(state, group, self._fresh, target, speed)
        self.face(response.looks, response.robot_w, group)
        return self.arrive(response.target_w, response.speed_mps, group) + _PUSHED_S * response.push_w
