"""The task of an actor that is an agent: walk to and fro between its way points, clear of the rover."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.frames import clip, wrap_angle
from dune_rl.settings import Settings

Array = NDArray[np.float64]

OBSERVATION_KEYS = ("goal", "rover", "velocity")


class WalkingConf(Settings):
    """Weights of a walker's reward."""

    progress_scale: float = 1.0
    near_miss: float = -0.1
    comfort_m: float = Field(1.2, gt=0.0)


def walker_observation(
    poses: Array,
    velocity_w: Array,
    goals_w: Array,
    rover_position_w: Array,
    rover_velocity_w: Array,
    limit_m: float,
    limit_mps: float = np.inf,
) -> dict[str, NDArray[np.float32]]:
    """What walkers sense, each (M, E, n).

    `goal`: distance [m] and bearing [rad] of the next way point; `rover`:
    distance [m] (at most `limit_m`), bearing [rad] and velocity relative to
    the walker's in its own frame [m/s] (2), each at most `limit_mps`; `velocity`: own, in its frame (2).
    `poses` (M, E, 4), `velocity_w` and `goals_w` (M, E, 2), rover's (M, 3), or of each walker (M, E, 3).
    """
    yaw = poses[..., 3]
    cos, sin = np.cos(yaw), np.sin(yaw)

    def polar(offset: Array) -> Array:
        distance = np.minimum(np.hypot(offset[..., 0], offset[..., 1]), limit_m)
        return np.stack([distance, wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - yaw)], axis=-1)

    def to_own_frame(vector: Array) -> Array:
        x, y = vector[..., 0], vector[..., 1]
        return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)

    position, velocity = (of.reshape(len(poses), -1, 3) for of in (rover_position_w, rover_velocity_w))
    rover = polar(position[..., :2] - poses[..., :2])
    closing = clip(to_own_frame(velocity[..., :2] - velocity_w), -limit_mps, limit_mps)
    return {
        "goal": polar(goals_w - poses[..., :2]).astype(np.float32),
        "rover": np.concatenate([rover, closing], axis=-1).astype(np.float32),
        "velocity": to_own_frame(velocity_w).astype(np.float32),
    }


def walker_reward(progress: Array, rover_distance: Array, conf: WalkingConf) -> Array:
    """Reward (M, E) for `progress` [m] toward the way point and for keeping `comfort_m` from the rover.

    `rover_distance` (M, E) is from surface to surface [m]; the near-miss part
    grows from 0 at `comfort_m` to all of it on contact.
    """
    closeness = np.clip(1.0 - rover_distance / conf.comfort_m, 0.0, 1.0)
    return conf.progress_scale * progress + conf.near_miss * closeness
