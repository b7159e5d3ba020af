"""How hard a kinematic body of a PyBullet scene pushes, and how far it has to step back."""

import math

# Between those of abdomen and thigh, 10 and 50 N/mm, in ISO/TS 15066. At 1 m/s the force grows by 100 N in a
# physics step of 5 ms, which is how far it can exceed the limit.
STIFFNESS_NPM, DAMPING_NSPM = 20e3, 200.0


class Push:
    """Horizontal force of a kinematic body on robots in a physics step, over all contact points."""

    def __init__(self) -> None:
        self._x = self._y = self._moment_nm = self._power_w = self._fastest_mps = self._farthest_m = 0.0
        self._points = 0

    def add(
        self, x: float, y: float, arm_x: float, arm_y: float, arm_m: float, speed_x: float, speed_y: float
    ) -> None:
        """Add the force (x, y) [N] at a point of a robot that moves with a velocity (x, y) [m/s].

        The point is at `arm_x` and `arm_y` [m] from the body's origin, `arm_m` away.
        """
        self._x += x
        self._y += y
        self._points += 1
        self._moment_nm += arm_x * y - arm_y * x
        self._power_w += x * speed_x + y * speed_y
        speed_mps = math.hypot(speed_x, speed_y)
        if speed_mps > self._fastest_mps:
            self._fastest_mps = speed_mps
        if arm_m > self._farthest_m:
            self._farthest_m = arm_m

    def retreat_m(
        self, way_x: float, way_y: float, turn_rad: float, limit_n: float, timestep_s: float
    ) -> tuple[float, float]:
        """Way (x, y) [m] that the body has to step back, so as not to push harder than `limit_n` next.

        It is about to advance by `way_x` and `way_y` [m] and to turn by `turn_rad`, and the robots move on.
        """
        force_n = math.hypot(self._x, self._y)
        # Robots on two sides may push with forces that cancel: then nothing pushes it away.
        if not force_n > 0.0:
            return 0.0, 0.0
        work_j = way_x * self._x + way_y * self._y - self._power_w * timestep_s
        swept_m = 0.0
        if turn_rad:
            work_j += turn_rad * self._moment_nm
            swept_m = abs(turn_rad) * self._farthest_m
        # Of one robot it is never more; of two whose forces nearly cancel it could be anything.
        fastest_m = 1.001 * (math.hypot(way_x, way_y) + swept_m + self._fastest_mps * timestep_s)
        closing_m = min(max(work_j / force_n, -fastest_m), fastest_m)
        excess_m = closing_m + (force_n - limit_n) / (self._points * STIFFNESS_NPM)
        if not excess_m > 0.0:
            return 0.0, 0.0
        return excess_m * self._x / force_n, excess_m * self._y / force_n
