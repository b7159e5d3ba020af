"""The behaviours `orca` and `social_force`: people, who react to robots in one of the six ways of HuNavSim.

Pérez-Higueras, Otero, Caballero & Merino, "HuNavSim: a ROS 2 human navigation simulator for benchmarking
human-aware robot navigation" (2023). What differs: the block of a threatening person is in front of the robot
by its heading, in HuNavSim by swapped sine and cosine; a reaction that keeps a person from walking on ends
after 30 s, and starts anew once the robot was out of sight for 10 s.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dune_rl.behaviours.destinations import DestinedBehaviour
from dune_rl.behaviours.social_force_loops import add_social_forces
from dune_rl.behaviours.steering import PauseRange, Places, Range, Speed, nearest_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors, wrap_angle
from dune_rl.state.state import GroupState, State

Reaction = Annotated[
    Literal["regular", "impassive", "surprised", "curious", "scared", "threatening"],
    Field(description="to robots; see docs/how_to/behaviours.md"),
]
Notice = Annotated[float, Field(gt=0.0, le=100.0, description="how near robots are noticed [m]")]

# People see to the sides, and a little behind [rad].
_HALF_VIEW_RAD = np.pi / 2 + 0.17
_KEEPS = 1.5
# The times of a reaction, and of its end [s].
_LASTS_S, _FORGETS_S = 30.0, 10.0
# A curious person's speed is this share of the usual one, times the distance over that of noticing; where it
# stops [m].
_CURIOUS_SHARE, _CURIOUS_STOP_M = 1.8, 1.5
# A threatening person's place ahead of the robot, from where it looks at the robot [m], and its haste.
_BLOCK_AHEAD_M, _BLOCK_NEAR_M, _BLOCK_HASTE = 1.4, 0.6, 1.5
# Of the force that drives a scared person away: factor [m/s²] and length [m]; HuNavSim's.
_SCARY_FACTOR_MPS2, _SCARY_LENGTH_M = 20.0, 0.2
_SCARED_HASTE = 1.4
# Time over which what pushes a scared person acts [s].
_PUSHED_S = 0.5
# People walk up to this much faster than they want to.
_HASTE = 1.3
Factor = Annotated[float, Field(ge=0.0, le=100.0, description="factor of this force; HuNavSim's by default")]


@dataclass(frozen=True)
class Response:
    """What a reaction makes of N people's plans: targets (N, 2) [m], speeds (N,) [m/s], who looks at the
    robot, (N,), and an acceleration (N, 2) [m/s²] away from it.
    """

    target_w: Array
    speed_mps: Array
    looks: Flags
    push_w: Array


class ReactingPeople(DestinedBehaviour):
    """People who go to `places`, or random ones, and react to the nearest robot that they notice.

    They notice it within `notice_m`, and in view, and know where it is until it is 1.5 times as far away.
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
        super().__init__(num_rows, speed_mps, places, range_m, pause_s)
        self.robots_share = 1.0 if reaction == "impassive" else self.robots_share
        self._reaction, self._notice_m = reaction, notice_m
        self._reacts_s, self._unseen_s = np.zeros((2, num_rows))
        self._notices = np.zeros(num_rows, bool)

    def respond(self, state: State, group: GroupState) -> Response:
        """What people who were on the way to their targets do; those that look at the robot face it."""
        target_w, pauses = self.targets(state, group)
        speed_mps = np.where(pauses, 0.0, self._speed_mps)
        place, _, robot_yaw, distance = nearest_of(state, group, "robots")
        here = group.motion.position_w[:, :2]
        direction, _ = unit_vectors(place - here)
        bearing = np.abs(wrap_angle(np.arctan2(direction[:, 1], direction[:, 0]) - group.motion.yaw))
        sees = (distance < self._notice_m) & (bearing < _HALF_VIEW_RAD)
        keeps = self._notices & ~self._fresh & (distance < _KEEPS * self._notice_m)
        self._notices = notices = sees | keeps
        step_s = group.episode.step_s
        self._unseen_s = np.where(notices | self._fresh, 0.0, self._unseen_s + step_s)
        starts = self._fresh | (self._unseen_s > _FORGETS_S)
        self._reacts_s = np.where(starts, 0.0, self._reacts_s + step_s * notices)
        # The reaction to the present robot ends after a while.
        reacts = notices & (self._reacts_s < _LASTS_S)
        looks = np.zeros(len(here), bool)
        push = np.zeros((len(here), 2))
        match self._reaction:
            case "surprised":
                looks = reacts
                speed_mps = np.where(reacts, 0.0, speed_mps)
            case "curious":
                looks = reacts & (distance < _CURIOUS_STOP_M)
                share = np.minimum(_CURIOUS_SHARE * distance / self._notice_m, 1.0)
                slow = share * speed_mps.max(initial=0.0)
                speed_mps = np.where(looks, 0.0, np.where(reacts, slow, speed_mps))
                target_w = np.where(reacts[:, None], place, target_w)
            case "scared":
                gap = np.maximum(distance - group.body.reach_m, 0.1)
                size = np.where(notices, _SCARY_FACTOR_MPS2 * _SCARY_LENGTH_M / gap, 0.0)
                push = -direction * size[:, None]
                speed_mps = np.where(notices, _SCARED_HASTE, 1.0) * speed_mps
            case "threatening":
                heading = np.stack([np.cos(robot_yaw), np.sin(robot_yaw)], axis=1)
                block = place + _BLOCK_AHEAD_M * heading
                arrived = np.hypot(*(block - here).T) < _BLOCK_NEAR_M / 2
                looks = reacts & (arrived | (distance < _BLOCK_NEAR_M))
                haste = _BLOCK_HASTE * speed_mps.max(initial=0.0)
                speed_mps = np.where(looks, 0.0, np.where(reacts, haste, speed_mps))
                target_w = np.where(reacts[:, None], block, target_w)
        self.face(looks, place, group)
        return Response(target_w, speed_mps, looks, push)


class Orca(ReactingPeople):
    """People who go to `places`, or random ones, past everybody; see `orca_loops`.

    `reaction` is how they react to robots that they notice within `notice_m`. Regular people count on the
    robot to make half of the way for them; impassive ones, for whom it is an obstacle, do not.
    """

    stream_name = "orca"

    def want(self, state: State, group: GroupState) -> Array:
        """To the target of the reaction, and away from what scares."""
        response = self.respond(state, group)
        return self.arrive(response.target_w, response.speed_mps, group) + _PUSHED_S * response.push_w


class SocialForce(ReactingPeople):
    """People who go to `places`, or random ones, moved by social forces; see `social_force_loops`.

    `reaction` is how they react to robots that they notice within `notice_m`.
    """

    stream_name = "social_force"

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
        super().__init__(
            num_rows, reaction=reaction, notice_m=notice_m, speed_mps=speed_mps, places=places,
            range_m=range_m, pause_s=pause_s,
        )  # fmt: skip
        self._factors = goal_factor, social_factor

    def want(self, state: State, group: GroupState) -> Array:
        """The velocity after a step under the forces."""
        response = self.respond(state, group)
        around = state.surroundings
        columns = around.columns(group.name)
        distance, direction = around.obstacles(group.name)
        wanted = group.by_scene(self.arrive(response.target_w, response.speed_mps, group))
        force = response.push_w.reshape(wanted.shape).copy()
        is_obstacle = around.is_robot & (self._reaction == "impassive")
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
