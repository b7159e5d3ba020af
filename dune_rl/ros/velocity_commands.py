"""Commands of ROS 2, a speed and a yaw rate (Twist), as actions, a speed and a relative heading."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.ros.times import NS_PER_S
from dune_rl.state.unicycle import Unicycle

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


def twist_of_action(vehicle: Unicycle, action: Array) -> tuple[float, float]:
    """Speed [m/s] and yaw rate [rad/s] of an action (2,), a speed and a relative heading.

    The yaw rate is that of the heading controller's proportional part: gain times heading, within limits.
    """
    return float(action[0]), float(vehicle.yaw_rates(action[1:].astype(float))[0])


def action_of_twist(vehicle: Unicycle, speed_mps: float, yaw_rate_radps: float) -> Array:
    """The action (2,) of a speed [m/s] and a yaw rate [rad/s]: the inverse of `twist_of_action`.

    The heading, yaw rate over gain, is given anew in every control step, so that the robot turns at that rate
    for as long as the command stands. Both are clipped to what the robot can do.
    """
    speed = min(max(speed_mps, vehicle.min_speed_mps), vehicle.max_speed_mps)
    most = vehicle.max_yaw_rate_radps
    heading = min(max(yaw_rate_radps, -most), most) / vehicle.heading_gain_per_s
    return np.array([speed, min(max(heading, -math.pi), math.pi)])


class VelocityCommands:
    """The latest command of one robot. It is at rest before the first one and `timeout_s` after the last one.

    `report` is called with what a user should know; `who` names the topic.
    """

    def __init__(self, vehicle: Unicycle, timeout_s: float, who: str, report: Callable[[str], None]) -> None:
        self._vehicle, self._timeout_ns = vehicle, round(timeout_s * NS_PER_S)
        self._who, self._timeout_s, self._report = who, timeout_s, report
        self._rest = np.zeros(2)
        self._action, self._given_ns = self._rest, -1
        self._is_faulty = False
        self.count = 0

    def take(self, message: Any, time_ns: int) -> None:
        """Take a Twist or a TwistStamped that came at a time of the simulation; the robot stops at NaN."""
        twist = getattr(message, "twist", message)
        speed, turn = float(twist.linear.x), float(twist.angular.z)
        self.count += 1
        is_faulty = not (math.isfinite(speed) and math.isfinite(turn))
        if is_faulty and not self._is_faulty:
            self._report(f"{self._who}: a command of {speed} m/s and {turn} rad/s: the robot stands still")
        self._is_faulty = is_faulty
        self._action = self._rest if is_faulty else action_of_twist(self._vehicle, speed, turn)
        self._given_ns = time_ns

    def action(self, time_ns: int) -> Array:
        """The action (2,) at a time of the simulation."""
        if self._given_ns >= 0 and time_ns - self._given_ns > self._timeout_ns:
            if self._action.any():
                self._report(
                    f"{self._who}: no command for {self._timeout_s:g} s of the simulation: the robot stands "
                    "still"
                )
            self.stop()
        return self._action

    def stop(self) -> None:
        """Come to rest until the next command."""
        self._action, self._given_ns = self._rest, -1
