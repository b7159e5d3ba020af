"""Work of a robot's motors in DART."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.drives import Drives
from dune_rl.physics.motors import motor_power_w


class WorkMeter:
    """Adds up the work of the motors of the skeleton `robot`, which is at rest at first."""

    def __init__(self, robot: Any, drives: Drives, timestep_s: float) -> None:
        self._robot, self._drives, self._timestep_s = robot, drives, timestep_s
        self._speeds: Sequence[float] = (0.0,) * len(drives.motors)
        self._work_j = 0.0

    def add(self) -> None:
        """Add the work of the last physics step."""
        drives = self._drives
        speeds = self._robot.getVelocities(drives.indices).tolist()
        # The joint speed changes linearly over a step under a constant torque.
        means = [(before + after) / 2 for before, after in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work_j += motor_power_w(drives.motors, means, drives.torques()) * self._timestep_s

    def take_j(self) -> float:
        """The work [J] since the last call."""
        work, self._work_j = self._work_j, 0.0
        return work
