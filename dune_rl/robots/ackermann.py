"""Ackermann drive: steering angles and wheel speeds for a commanded speed and heading."""

import numpy as np
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip
from dune_rl.robots.heading import HeadingConf, HeadingController
from dune_rl.robots.steering_geometry import SteeringGeometry

# A heading error below this share of a radian does not steer fully, however slow the robot is: otherwise the
# wheels would swing from stop to stop at noise.
_FULL_LOCK_RAD = 0.25
# Below this speed a robot that is to stand keeps its wheels as they are.
_STANDING_MPS = 1e-3


class AckermannConf(Settings):
    """Limits of the drive.

    `arc_speed_mps` is the speed at most at which it drives the smallest circle where a heading is commanded
    without the speed that it takes. `max_steering_rate_radps` is that of the wheels about their pivots.
    """

    max_speed_mps: float = Field(1.0, gt=0.0, le=10.0)
    max_yaw_rate_radps: float = Field(1.5, gt=0.0, le=10.0)
    max_acceleration_mps2: float = Field(2.5, gt=0.0)
    max_lateral_acceleration_mps2: float = Field(3.0, gt=0.0)
    max_steering_rate_radps: float = Field(2.0, gt=0.0)
    arc_speed_mps: float = Field(0.25, gt=0.0, le=10.0)


class AckermannDrive:
    """Converts speeds and headings of N robots to speeds of their wheels and angles of their steering joints.

    The yaw rate of the heading controller is driven as a curve of that yaw rate over the speed, no tighter
    than the smallest circle. A robot that steers cannot turn on the spot: where the commanded speed is too
    low for the yaw rate, it drives the smallest circle at up to `arc_speed_mps`, forward unless the command
    is to reverse. A heading that lies behind is approached on the smallest circle as well. In reverse it
    steers the other way, so that the body turns to the commanded heading, too.
    """

    def __init__(
        self, conf: AckermannConf, heading: HeadingConf, geometry: SteeringGeometry, num_robots: int
    ) -> None:
        self._conf, self.geometry = conf, geometry
        self._heading = HeadingController(heading, conf.max_yaw_rate_radps, num_robots)
        left, right = geometry.max_curvatures()
        self._lowest, self._highest = -right, left
        tightest = max(left, right)
        largest = float(np.abs(geometry.steering_angles(np.array([self._lowest, self._highest]))).max())
        self._curvature_per_rad = tightest / max(largest, 1e-6)
        self._slowest = heading.kp * _FULL_LOCK_RAD / tightest
        self._speed = np.zeros(num_robots)
        self._curvature = np.zeros(num_robots)

    @property
    def turning_radius_m(self) -> float:
        """Radius [m] of the smallest circle to the side that turns less, of the middle of the axle."""
        return 1.0 / min(self._highest, -self._lowest)

    def reset(self, mask: Flags) -> None:
        """Stand still with straight wheels, and clear the heading controller, in `mask` (N,)."""
        self._heading.reset(mask)
        self._speed[mask] = 0.0
        self._curvature[mask] = 0.0

    def commands(self, speed: Array, heading_error: Array, step_s: float) -> Array:
        """Speeds of the driven wheels [rad/s] and angles of the steering joints [rad], (N, D + S).

        `speed` (N,) [m/s] and `heading_error` (N,) [rad] are clipped to the platform's limits.
        """
        conf = self._conf
        speed = clip(speed, -conf.max_speed_mps, conf.max_speed_mps)
        yaw_rate = self._heading.yaw_rate(clip(heading_error, -np.pi, np.pi), step_s)
        forward = np.where(speed < 0.0, -1.0, 1.0)
        tightest = np.where(yaw_rate * forward > 0.0, self._highest, -self._lowest)
        arc = np.minimum(np.abs(yaw_rate) / tightest, min(conf.arc_speed_mps, conf.max_speed_mps))
        target = forward * np.maximum(np.abs(speed), arc)
        gain = conf.max_acceleration_mps2 * step_s
        self._speed = clip(target, self._speed - gain, self._speed + gain)
        self._steer(yaw_rate, target, step_s)
        rolling = self._speed[:, None] * self.geometry.speed_ratios(self._curvature)
        angles = self.geometry.steering_angles(self._curvature)
        return np.concatenate([rolling / self.geometry.wheel_radius_m, angles], axis=1)

    def _steer(self, yaw_rate: Array, target: Array, step_s: float) -> None:
        """Change the curvature toward that of a yaw rate (N,) at the present speed."""
        conf = self._conf
        pace = np.abs(self._speed)
        most = conf.max_lateral_acceleration_mps2 / np.maximum(pace, 1e-6)
        moves_back = np.where(pace > _STANDING_MPS, self._speed < 0.0, target < 0.0)
        curvature = clip(yaw_rate, -most, most) / np.maximum(pace, self._slowest)
        curvature = clip(np.where(moves_back, -curvature, curvature), self._lowest, self._highest)
        stands = (pace <= _STANDING_MPS) & (np.abs(target) <= _STANDING_MPS)
        gain = conf.max_steering_rate_radps * self._curvature_per_rad * step_s
        changed = clip(curvature, self._curvature - gain, self._curvature + gain)
        self._curvature = np.where(stands, self._curvature, changed)
