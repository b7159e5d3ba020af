"""The reward of point-goal navigation, term by term.

The formulae are those of Vice & Sukthankar 2025, section 2.6 and Table 2. The
published code differs in its numbers; `conf/task/dune_code.yaml` has them.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.settings import Settings
from dune_rl.tasks.snapshot import Array, Snapshot


class RewardConf(Settings):
    """Weights and thresholds of the terms."""

    alpha: float = Field(1.5, description="multiplier of distance and heading")
    distance_scale: float = 0.3
    # Progress of no more than this, or away from the goal, earns the misaligned reward.
    min_progress_m: float = Field(0.0, ge=0.0)
    # Whether moving away within the heading limit earns its negative distance, as in the published code.
    signed_progress: bool = False
    heading_limit_rad: float = Field(np.pi / 2, gt=0.0, le=np.pi)
    misaligned: float = -0.001
    heading_bonus: float = 0.01
    velocity_scale: float = 0.0025
    turn_scale: float = 0.0
    goal: float = 100.0
    collision: float = -0.5
    # Clearance of the hull [m] below which a step earns the collision reward.
    collision_distance_m: float = Field(0.2, ge=0.0)
    # Earned once per encounter, beside the rest. Ours: with the paper's terms alone a bump costs less
    # than the time it saves. `task=paper` leaves it out.
    contact: float = -10.0
    stuck: float = 0.0
    flipped: float = 0.0
    out_of_world: float = 0.0


def distance(now: Snapshot, conf: RewardConf) -> Array:
    """Reward for progress, shape (M,): scaled metres toward the goal while facing it."""
    progress = now.previous_goal_distance - now.goal_distance
    moved = np.abs(progress) if conf.signed_progress else progress
    earns = (moved > conf.min_progress_m) & (np.abs(now.goal_heading) <= conf.heading_limit_rad)
    return np.where(earns, progress * conf.distance_scale, conf.misaligned)


def heading(now: Snapshot, conf: RewardConf) -> Array:
    """Reward for facing the goal, shape (M,): 1 x bonus at 0, 0 at pi/2, falling to -1 x bonus at pi."""
    angle = np.abs(now.goal_heading)
    toward = 1.0 - 2.0 * angle / np.pi
    away = -2.0 * (angle - np.pi / 2) / np.pi
    return conf.heading_bonus * np.where(angle <= np.pi / 2, toward, away)


def velocity(now: Snapshot, conf: RewardConf) -> Array:
    """Reward for forward speed less the cost of turning, shape (M,)."""
    return conf.velocity_scale * now.speed - conf.turn_scale * np.abs(now.angular_b[:, 2])


REWARD_TERMS = ("distance", "heading", "velocity", "goal", "collision", "contact", "ending")


def reward_terms(
    now: Snapshot,
    conf: RewardConf,
    reached: NDArray[np.bool_],
    stuck: NDArray[np.bool_],
    flipped: NDArray[np.bool_],
) -> Array:
    """Every term's part of the reward, shape (M, 7), columns as in `REWARD_TERMS`.

    A goal, and after it a close obstacle, count at once and instead of the
    terms of navigation.
    """
    close = (now.clearance < conf.collision_distance_m) | now.touching
    navigating = ~reached & ~close
    out = np.zeros((len(reached), len(REWARD_TERMS)))
    out[:, 0] = np.where(navigating, conf.alpha * distance(now, conf), 0.0)
    out[:, 1] = np.where(navigating, conf.alpha * heading(now, conf), 0.0)
    out[:, 2] = np.where(navigating, velocity(now, conf), 0.0)
    out[:, 3] = np.where(reached, conf.goal, 0.0)
    out[:, 4] = np.where(close & ~reached, conf.collision, 0.0)
    out[:, 5] = conf.contact * now.new_collisions
    out[:, 6] = conf.stuck * stuck + conf.flipped * flipped + conf.out_of_world * now.out_of_world
    return out
