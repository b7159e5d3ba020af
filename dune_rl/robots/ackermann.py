"""Ackermann drive: steering angles and wheel speeds for a commanded speed and heading, and their geometry."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import clip
from dune_rl.robots.heading import HeadingConf, HeadingController

_NO_LEVER_M = 1e-3
# A heading error below this share of a radian does not steer fully, however slow the robot is: otherwise the
# wheels would swing from stop to stop at noise.
_FULL_LOCK_RAD = 0.25
# Below this speed a robot that is to stand keeps its wheels as they are.
_STANDING_MPS = 1e-3


@dataclass(frozen=True, eq=False)
class SteeringGeometry:
    """Rigid body motion about a turning centre on the line x = `turning_x_m`, on which the axles that do not
    steer lie.

    Curvature [1/m] is the yaw rate over the forward speed at (`turning_x_m`, 0), positive to the left. With
    p = (x, y) relative to that point, a wheel's direction is atan(k x / (1 - k y)), so that all axles meet
    in the turning centre (Ackermann's condition).

    The S steering joints turn about axes at `pivots_b` (S, 2) [m]. Angles are positive to the left: a joint's
    angle is `signs` (S,) times it, and `limits` (S, 2) [rad] are the lowest and the highest.

    The D wheels with motors are the robot's first joints, and the steering joints those behind them.
    `wheel_pivots_b` (D, 2) [m] are their centres, or the axes of their steering joints, from which the wheels
    are `wheel_offsets_m` (D,) to the left along the axle; `steered` (D,) marks the latter.
    """

    turning_x_m: float
    pivots_b: Array
    signs: Array
    limits: Array
    wheel_pivots_b: Array
    wheel_offsets_m: Array
    steered: Flags
    wheel_radius_m: float

    @property
    def num_wheels(self) -> int:
        """Number of wheels with motors."""
        return len(self.wheel_pivots_b)

    @property
    def track_m(self) -> float:
        """Distance [m] between the outermost driven wheels, for bounds of odometry; at least a radius."""
        across = self.wheel_pivots_b[:, 1] + self.wheel_offsets_m
        return max(float(np.ptp(across)), self.wheel_radius_m)

    def max_curvatures(self) -> tuple[float, float]:
        """Largest curvature [1/m] of a turn to the left and to the right, by the steering limits."""
        lever, across = self._levers()
        found = []
        for side, limits in ((1.0, self.limits), (-1.0, -self.limits[:, ::-1])):
            # In front of the axle wheels turn toward the centre, behind it away from it.
            angle = np.where(lever > 0.0, limits[:, 1], -limits[:, 0])
            tangent = np.tan(np.clip(angle, 0.0, np.deg2rad(85.0)))
            reach = np.abs(lever) + side * across * tangent
            curvature = np.where(reach > _NO_LEVER_M, tangent / np.maximum(reach, _NO_LEVER_M), np.inf)
            found.append(float(curvature[np.abs(lever) > _NO_LEVER_M].min(initial=np.inf)))
        return found[0], found[1]

    def steering_angles(self, curvature: Array) -> Array:
        """Angles of the steering joints [rad], (N, S), for curvatures (N,)."""
        lever, across = self._levers()
        bent = curvature[:, None]
        angles = np.arctan2(bent * lever, 1.0 - bent * across)
        limits = self.limits
        clipped: Array = np.minimum(np.maximum(angles, limits[:, 0]), limits[:, 1]) * self.signs
        return clipped

    def speed_ratios(self, curvature: Array) -> Array:
        """Speed of each driven wheel's rim over the robot's speed, (N, D), for curvatures (N,)."""
        bent = curvature[:, None]
        ahead = 1.0 - bent * self.wheel_pivots_b[:, 1]
        aside = np.where(self.steered, bent * (self.wheel_pivots_b[:, 0] - self.turning_x_m), 0.0)
        # The wheel is beside its pivot, on the axle, which is at right angles to its direction.
        ratios: Array = np.where(self.steered, np.hypot(ahead, aside), ahead) - bent * self.wheel_offsets_m
        return ratios

    def curvature(self, steering: Array) -> Array:
        """Curvature [1/m], (N,), that angles of the steering joints (N, S) [rad] make: their mean.

        It is the inverse of `steering_angles`.
        """
        lever, across = self._levers()
        tangent = np.tan(steering * self.signs)
        useful = np.abs(lever) > _NO_LEVER_M
        bent = tangent[:, useful] / (lever[useful] + across[useful] * tangent[:, useful])
        mean: Array = bent.mean(axis=1)
        return mean

    def motion(self, turned: Array, angles: Array) -> Array:
        """Way ahead [m] and turn [rad] of N robots, (N, 2), by the bicycle model.

        `turned` (N, D) [rad] is how far the driven wheels have turned meanwhile, and `angles` (N, J) [rad]
        are those of all motors' joints.
        """
        curvature = self.curvature(angles[:, self.num_wheels :])
        ratios = self.speed_ratios(curvature)
        # Least squares over the wheels: one on the turning centre, which does not roll, has no weight.
        rolled = turned * self.wheel_radius_m
        ahead = (rolled * ratios).sum(axis=1) / np.maximum((ratios * ratios).sum(axis=1), 1e-9)
        return np.stack([ahead, ahead * curvature], axis=1)

    def _levers(self) -> tuple[Array, Array]:
        return self.pivots_b[:, 0] - self.turning_x_m, self.pivots_b[:, 1]


class AckermannConf(Settings):
    """Limits of the drive.

    `arc_speed_mps` is the speed limit on the smallest turning circle, when only a heading is commanded.
    `max_steering_rate_radps` is the speed limit of the wheels about their pivots.
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
