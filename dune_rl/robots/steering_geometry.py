"""Ackermann geometry: steering angles and wheel speeds of a curvature, and the motion that they measure."""

from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array, Flags

_NO_LEVER_M = 1e-3


@dataclass(frozen=True, eq=False)
class SteeredPivots:
    """S joints that steer wheels, in the robot's frame.

    `positions_b` (S, 2) [m] are x and y of their axes. Angles are positive to the left: a joint's angle is
    `signs` (S,) times it, and `limits` (S, 2) [rad] are the lowest and the highest.
    """

    positions_b: Array
    signs: Array
    limits: Array


@dataclass(frozen=True, eq=False)
class SteeringGeometry:
    """Rigid body motion about a turning centre on the line x = `turning_x_m`, on which the axles that do not
    steer lie.

    Curvature [1/m] is the yaw rate over the forward speed at (`turning_x_m`, 0), positive to the left. With
    p = (x, y) relative to that point, a wheel's direction is atan(k x / (1 - k y)), so that all axles meet
    in the turning centre (Ackermann's condition).

    The D wheels with motors are the robot's first joints, and the steering joints those behind them.
    `wheel_pivots_b` (D, 2) [m] are their centres, or the axes of their steering joints, from which the wheels
    are `wheel_offsets_m` (D,) to the left along the axle; `steered` (D,) marks the latter.
    """

    turning_x_m: float
    pivots: SteeredPivots
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
        for side, limits in ((1.0, self.pivots.limits), (-1.0, -self.pivots.limits[:, ::-1])):
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
        limits = self.pivots.limits
        clipped: Array = np.minimum(np.maximum(angles, limits[:, 0]), limits[:, 1]) * self.pivots.signs
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
        tangent = np.tan(steering * self.pivots.signs)
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
        return self.pivots.positions_b[:, 0] - self.turning_x_m, self.pivots.positions_b[:, 1]
