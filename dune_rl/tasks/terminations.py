"""When an episode of point-goal navigation ends."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from dune_rl.settings import Settings
from dune_rl.tasks.snapshot import Flags, Snapshot


class TerminationConf(Settings):
    """Thresholds. The goal, being stuck or flipped, and leaving the world terminate; time truncates."""

    goal_distance_m: float = Field(0.75, gt=0.0)
    max_steps: int = Field(2000, ge=1)
    # Stuck: less than this far from where it was this long ago.
    stuck_distance_m: float = Field(0.1, ge=0.0)
    stuck_steps: int = Field(300, ge=1)
    flipped_rad: float = Field(np.deg2rad(85.0), gt=0.0, le=np.pi)
    # Draw a new goal when one is reached and go on, as the published code does.
    continue_after_goal: bool = False


@dataclass(frozen=True)
class Endings:
    """Why the rovers' episodes end, each (M,)."""

    reached: Flags
    stuck: Flags
    flipped: Flags
    out_of_world: Flags
    timeout: Flags
    diverged: Flags
    terminated: Flags
    truncated: Flags


def endings(now: Snapshot, conf: TerminationConf) -> Endings:
    """What ends now. Diverged physics truncates whatever else seems to be the case."""
    usable = ~now.diverged
    reached = usable & (now.goal_distance < conf.goal_distance_m)
    roll_or_pitch = np.abs(now.roll_pitch_yaw[:, :2]).max(axis=1)
    # Upside down has small roll and pitch in some conventions; the tilt tells it apart.
    flipped = usable & ((roll_or_pitch > conf.flipped_rad) | (now.tilt > conf.flipped_rad))
    stuck = usable & (now.steps_since_moved >= conf.stuck_steps)
    out = usable & now.out_of_world
    terminated = stuck | flipped | out
    if not conf.continue_after_goal:
        terminated = terminated | reached
    timeout = usable & ~terminated & (now.steps >= conf.max_steps)
    return Endings(reached, stuck, flipped, out, timeout, now.diverged, terminated, timeout | now.diverged)
