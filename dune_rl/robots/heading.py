"""PID controller from a commanded heading to a yaw rate."""

import numpy as np
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip, wrap_angle


class HeadingConf(Settings):
    """Gains of the published controller, which runs at the control rate."""

    kp: float = Field(2.0, ge=0.0)
    ki: float = Field(0.0, ge=0.0)
    kd: float = Field(0.1, ge=0.0)


class HeadingController:
    """PID controller on the heading errors of N robots; its yaw rate is limited both ways."""

    def __init__(self, conf: HeadingConf, max_yaw_rate_radps: float, num_robots: int) -> None:
        self._conf = conf
        self._limit = max_yaw_rate_radps
        self._integral = np.zeros(num_robots)
        self._previous = np.full(num_robots, np.nan)

    def reset(self, mask: Flags) -> None:
        """Clear integral and previous error of the robots in `mask` (N,)."""
        self._integral[mask] = 0.0
        self._previous[mask] = np.nan

    def yaw_rate(self, heading_error: Array, step_s: float) -> Array:
        """Commanded yaw rate [rad/s], (N,), for the heading errors (N,) [rad], in [-pi, pi]."""
        conf = self._conf
        previous = np.where(np.isnan(self._previous), heading_error, self._previous)
        change = wrap_angle(heading_error - previous) / step_s
        self._previous = heading_error.copy()
        self._integral += heading_error * step_s
        target = conf.kp * heading_error + conf.ki * self._integral + conf.kd * change
        return clip(target, -self._limit, self._limit)
