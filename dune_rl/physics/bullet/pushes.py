"""How hard a kinematic body of a PyBullet scene pushes, and how far it has to step back."""

import math
from collections.abc import Sequence

# Between those of abdomen and thigh, 10 and 50 N/mm, in ISO/TS 15066. At 1 m/s the force grows by 100 N in a
# physics step of 5 ms, which is how far it can exceed the limit.
STIFFNESS_NPM, DAMPING_NSPM = 20e3, 200.0


class Push:
    """Horizontal force of a kinematic body on robots in a physics step, over all contact points."""

    def __init__(self) -> None:
        self._x = self._y = self._moment_nm = self._power_w = self._fastest_mps = self._farthest_m = 0.0
        self._points = 0

    def add(
        self, force: tuple[float, float], arm: tuple[float, float], velocity: tuple[float, float]
    ) -> None:
        """Add the force (x, y) [N] at a point of a robot with a horizontal velocity [m/s].

        The point is at `arm` (x, y) [m] from the body's origin.
        """
        x, y = force
        self._x, self._y, self._points = self._x + x, self._y + y, self._points + 1
        self._moment_nm += arm[0] * y - arm[1] * x
        self._power_w += x * velocity[0] + y * velocity[1]
        self._fastest_mps = max(self._fastest_mps, math.hypot(*velocity))
        self._farthest_m = max(self._farthest_m, math.hypot(*arm))

    def retreat_m(
        self, advance_m: Sequence[float], turn_rad: float, limit_n: float, timestep_s: float
    ) -> tuple[float, float]:
        """Way (x, y) [m] that the body has to step back, so as not to push harder than `limit_n` next.

        It is about to advance by `advance_m` (x, y) and to turn by `turn_rad`, and the robots move on.
        """
        force_n = math.hypot(self._x, self._y)
        # Robots on two sides may push with forces that cancel: then nothing pushes it away.
        if not force_n > 0.0:
            return 0.0, 0.0
        work_j = advance_m[0] * self._x + advance_m[1] * self._y - self._power_w * timestep_s
        swept_m = 0.0
        if turn_rad:
            work_j += turn_rad * self._moment_nm
            swept_m = abs(turn_rad) * self._farthest_m
        # Of one robot it is never more; of two whose forces nearly cancel it could be anything.
        fastest_m = 1.001 * (math.hypot(*advance_m) + swept_m + self._fastest_mps * timestep_s)
        closing_m = min(max(work_j / force_n, -fastest_m), fastest_m)
        excess_m = closing_m + (force_n - limit_n) / (self._points * STIFFNESS_NPM)
        if not excess_m > 0.0:
            return 0.0, 0.0
        return excess_m * self._x / force_n, excess_m * self._y / force_n
