"""The behaviours `path` and `trajectory`: agents are moved along a path, whatever is in their way."""

from typing import Protocol

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.state import GroupState, State


class Follower(Protocol):
    """Moves N agents along paths (`PathFollower`) or trajectories (`TrajectoryFollower`)."""

    def advance(self, step_s: float) -> Array:
        """The poses (N, 4: x, y, z, yaw) [m, rad] of the agents after `step_s`."""
        ...


class FollowPath:
    """Moves agents along their paths. Actions are poses (N, 4), for `KinematicBody(is_prescribed=True)`."""

    def __init__(self, follower: Follower) -> None:
        self._follower = follower

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing: the source of starts puts agents on their paths."""

    def act(self, state: State, group: GroupState) -> Array:
        """The poses (N, 4) of the agents at the end of the next control step."""
        return self._follower.advance(group.episode.step_s)
