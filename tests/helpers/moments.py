"""Moments of rovers at rest, for sensors to read."""

import numpy as np
from scanning import moment_of
from scenes import about

from dune_rl.env.motion import Motion
from dune_rl.geometry.frames import multiply_quaternions
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.sensors.sensor import Moment


def moment_at(
    positions: np.ndarray, yaws: np.ndarray, actors: np.ndarray | None = None, pitch: float = 0.0
) -> Moment:
    """Rovers at `positions` (M, 3) that head `yaws` (M,), noses down by `pitch`; `actors` are (M, K, 4)."""
    motion = Motion(len(positions), RoverZero(RoverZeroConf(), 1))
    for row, (position, yaw) in enumerate(zip(positions, yaws, strict=True)):
        quaternion = multiply_quaternions(about([0, 0, 1], yaw), about([0, 1, 0], pitch))
        motion.set_row(row, (*position, *quaternion, *[0.0] * 6))
    motion.begin(np.ones(len(positions), bool))
    return moment_of(motion, actors)
