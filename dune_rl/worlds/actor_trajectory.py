"""Timed way-points of an actor that a world's file brings along."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField

# Limits of files: way-points of an actor, when its last is reached [s], and how far off one may be [m].
MOST_WAY_POINTS, LONGEST_S, FARTHEST_M = 20_000, 1e6, 1e6
# Origins of actors are up to this high above the ground that they walk on: Gazebo's are at the hip.
_HIGHEST_ORIGIN_M = 2.0
# Turns of half a circle are to the left, whatever rounding makes of them [rad].
_HALF_TURN_ROOM = 1e-4


@dataclass(frozen=True, eq=False)
class ActorTrajectory:
    """Poses of an actor over time, linear between its way-points.

    `times` (T,) [s] rise strictly from 0, `poses` (T, 4) are x, y, z [m] and yaw [rad], which may be beyond
    [-pi, pi) so that turns are the shorter ones. The actor stands at its first pose for `delay_s`. After the
    last way-point it stays there or, with `loop`, begins anew with the delay. `on_ground` says that it walks
    on the ground whatever z is.
    """

    name: str
    times: Array
    poses: Array
    loop: bool = True
    delay_s: float = 0.0
    on_ground: bool = True

    @property
    def duration_s(self) -> float:
        """Time from the first to the last way-point [s]."""
        return float(self.times[-1])

    def set_on_ground(self, terrain: HeightField) -> Self:
        """The trajectory with `on_ground` set if all of it is near the ground of `terrain`."""
        over = self.poses[:, 2] - terrain.height(self.poses[:, :2])
        return replace(self, on_ground=bool((over <= _HIGHEST_ORIGIN_M).all()))


def unwrap_yaw(yaw: Array) -> Array:
    """Yaw (T,) [rad] without jumps of a whole turn: turns are the shorter ones, half turns to the left."""
    turns = np.floor((np.pi + _HALF_TURN_ROOM - np.diff(yaw, prepend=yaw[:1])) / (2 * np.pi))
    return np.asarray(yaw + 2 * np.pi * np.cumsum(turns))
