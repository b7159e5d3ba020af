"""The behaviour `social_force`: people by the social force model, with a reaction to robots."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.destinations import Destinations, DestinedBehaviour
from dune_rl.behaviours.ranges import PauseRange, Places, Range, Speed
from dune_rl.behaviours.reactions import Notice, Reaction, Reactions
from dune_rl.behaviours.social_force_loops import add_social_forces
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

Factor = Annotated[float, Field(ge=0.0, le=100.0, description="factor of this force; HuNavSim's by default")]

# People walk up to this much faster than they want to.
_HASTE = 1.3


class SocialForce(DestinedBehaviour):
    """People who go to `places`, or random ones, moved by social forces; see `social_force_loops`.

    `reaction` is how they react to robots that they notice within `notice_m`; see `reactions`.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        reaction: Reaction = "regular",
        notice_m: Notice = 4.0,
        speed_mps: Speed = 1.0,
        goal_factor: Factor = 2.0,
        social_factor: Factor = 2.1,
        places: Places = (),
        range_m: Range = 8.0,
        pause_s: PauseRange = (0.0, 3.0),
    ) -> None:
        places_w = np.array(places, float).reshape(-1, 2)
        super().__init__(
            num_rows, speed_mps, Destinations(num_rows, "social_force", places_w, range_m, pause_s)
        )
        self._reactions = Reactions(num_rows, reaction, notice_m)
        self._factors = goal_factor, social_factor

    def want(self, state: State, group: GroupState) -> Array:
        """The velocity after a step under the forces."""
        target, pauses = self.targets(state, group)
        speed = np.where(pauses, 0.0, self._speed_mps)
        response = self._reactions.respond(state, group, self._fresh, target, speed)
        self.face(response.looks, response.robot_w, group)
        around = state.surroundings
        columns = around.columns(group.name)
        distance, direction = around.obstacles(group.name)
        wanted = group.by_scene(self.arrive(response.target_w, response.speed_mps, group))
        force = response.push_w.reshape(wanted.shape).copy()
        is_obstacle = around.is_robot & (self._reactions.name == "impassive")
        add_social_forces(
            around.position_w, around.velocity_w, around.reach_m, is_obstacle, columns.start,
            np.ascontiguousarray(distance), np.ascontiguousarray(direction), wanted, self._factors, force,
        )  # fmt: skip
        velocity = group.motion.velocity_w[:, :2] + force.reshape(-1, 2) * group.episode.step_s
        course, size = unit_vectors(velocity)
        most = np.maximum(response.speed_mps, self._speed_mps * ~response.looks) * _HASTE
        return course * np.minimum(size, most)[:, None]

    def avoid(self, state: State, group: GroupState, wanted: Array) -> Array:
        """The forces have done it."""
        return wanted
