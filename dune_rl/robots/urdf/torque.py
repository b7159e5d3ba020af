"""Torques of motors that a URDF does not limit: what turning on the spot, climbing and steering take."""

from collections.abc import Sequence

import numpy as np

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array

# Torque over what equally loaded wheels on level ground take: loads differ, and the ground's friction acts
# along both axes of the world, with up to sqrt(2) times its coefficient.
_MARGIN = 2.0
# A limit so many times as high as what is needed stands for none.
NO_LIMIT_RATIO = 50.0


def turning_torque(
    mass_kg: float, friction: float, radius_m: float, driven_b: Array, wheels_b: Array
) -> float:
    """Torque [N m] of each driven wheel, at `driven_b` (D, 3) [m], with which a robot turns on the spot.

    All wheels, at `wheels_b` (W, 3) [m], carry the weight m g in equal parts. Turned about their middle, they
    scrub along their axles, which takes the moment M = mu m g mean|x|; wheels driven at the rim with F each
    make D F mean|y|. So F = mu m g mean|x| / (D mean|y|). It is limited to the grip, mu m g / D: a robot that
    is longer than wide turns with spinning wheels.
    """
    lever_x = float(np.abs(wheels_b[:, 0] - wheels_b[:, 0].mean()).mean())
    lever_y = float(np.abs(driven_b[:, 1] - driven_b[:, 1].mean()).mean())
    share = min(1.0, lever_x / lever_y) if lever_y > 0.0 else 1.0
    return _MARGIN * friction * mass_kg * GRAVITY_MPS2 / len(driven_b) * radius_m * share


def climbing_torque(mass_kg: float, friction: float, radius_m: float, num_wheels: int) -> float:
    """Torque [N m] of each of the driven wheels that reaches its grip if they carry the whole weight."""
    return max(friction, 1.0) * mass_kg * GRAVITY_MPS2 * radius_m / num_wheels


def steering_torque(mass_kg: float, friction: float, levers_m: Sequence[float], num_wheels: int) -> float:
    """Torque [N m] of each steering joint that turns a standing wheel.

    `levers_m` are the distances of the wheels' farthest points of contact from their pivots; the wheels
    carry the weight in equal parts.
    """
    return _MARGIN * friction * mass_kg * GRAVITY_MPS2 / num_wheels * max(levers_m)
