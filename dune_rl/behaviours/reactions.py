"""How people react to robots: the six ways of HuNavSim.

Pérez-Higueras, Otero, Caballero & Merino, "HuNavSim: a ROS 2 human navigation simulator for benchmarking
human-aware robot navigation" (2023). What differs: the block of a threatening person is in front of the robot
by its heading, in HuNavSim by swapped sine and cosine; a reaction that keeps a person from walking on ends
after 30 s, and starts anew once the robot was out of sight for 10 s.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dune_rl.behaviours.steering import nearest_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors, wrap_angle
from dune_rl.state.state import GroupState, State

ReactionName = Literal["regular", "impassive", "surprised", "curious", "scared", "threatening"]
Reaction = Annotated[ReactionName, Field(description="to robots; see docs/how_to/behaviours.md")]
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


@dataclass(frozen=True)
class Response:
    """What a reaction makes of N people's plans: targets (N, 2) [m], speeds (N,) [m/s], who looks at the
    robot, (N,), where it is, (N, 2) [m], and an acceleration (N, 2) [m/s²] away from it.
    """

    target_w: Array
    speed_mps: Array
    looks: Flags
    robot_w: Array
    push_w: Array


class Reactions:
    """Reactions of N people to the nearest robot that they notice: within `notice_m`, and in view.

    Who has noticed it knows where it is, until it is 1.5 times as far away.
    """

    def __init__(self, num_rows: int, reaction: ReactionName, notice_m: float) -> None:
        self.name: ReactionName = reaction
        self._notice_m = notice_m
        self._reacts_s, self._unseen_s = np.zeros((2, num_rows))
        self._notices = np.zeros(num_rows, bool)

    def respond(
        self, state: State, group: GroupState, fresh: Flags, target_w: Array, speed_mps: Array
    ) -> Response:
        """What people who were on the way to `target_w` (N, 2) at `speed_mps` (N,) do."""
        place, _, robot_yaw, distance = nearest_of(state, group, "robots")
        here = group.motion.position_w[:, :2]
        direction, _ = unit_vectors(place - here)
        bearing = np.abs(wrap_angle(np.arctan2(direction[:, 1], direction[:, 0]) - group.motion.yaw))
        sees = (distance < self._notice_m) & (bearing < _HALF_VIEW_RAD)
        keeps = self._notices & ~fresh & (distance < _KEEPS * self._notice_m)
        self._notices = notices = sees | keeps
        reacts = notices & self._is_engaged(notices, fresh, group.episode.step_s)
        looks = np.zeros(len(here), bool)
        push = np.zeros((len(here), 2))
        match self.name:
            case "surprised":
                looks = reacts
                speed_mps = np.where(reacts, 0.0, speed_mps)
            case "curious":
                looks = reacts & (distance < _CURIOUS_STOP_M)
                slow = np.minimum(_CURIOUS_SHARE * distance / self._notice_m, 1.0) * speed_mps.max(
                    initial=0.0
                )
                speed_mps = np.where(looks, 0.0, np.where(reacts, slow, speed_mps))
                target_w = np.where(reacts[:, None], place, target_w)
            case "scared":
                gap = np.maximum(distance - group.body.reach_m, 0.1)
                push = (
                    -direction * np.where(notices, _SCARY_FACTOR_MPS2 * _SCARY_LENGTH_M / gap, 0.0)[:, None]
                )
                speed_mps = np.where(notices, _SCARED_HASTE, 1.0) * speed_mps
            case "threatening":
                heading = np.stack([np.cos(robot_yaw), np.sin(robot_yaw)], axis=1)
                block = place + _BLOCK_AHEAD_M * heading
                arrived = np.hypot(*(block - here).T) < _BLOCK_NEAR_M / 2
                looks = reacts & (arrived | (distance < _BLOCK_NEAR_M))
                haste = _BLOCK_HASTE * speed_mps.max(initial=0.0)
                speed_mps = np.where(looks, 0.0, np.where(reacts, haste, speed_mps))
                target_w = np.where(reacts[:, None], block, target_w)
        return Response(target_w, speed_mps, looks, place, push)

    def _is_engaged(self, notices: Flags, fresh: Flags, step_s: float) -> Flags:
        """Flags (N,) of people whose reaction to the present robot has not ended yet."""
        unseen = np.where(notices | fresh, 0.0, self._unseen_s + step_s)
        starts = fresh | (unseen > _FORGETS_S)
        self._reacts_s = np.where(starts, 0.0, self._reacts_s + step_s * notices)
        self._unseen_s = unseen
        return self._reacts_s < _LASTS_S
