"""What tall grass does to rovers that drive in it."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.motion import Motion
from dune_rl.robots.robot import Robot
from dune_rl.worlds.grass import Grass

Array = NDArray[np.float64]


def grass_force(grass: Grass, motion: Motion, robot: Robot) -> Array:
    """Force [N] on each rover, (M, 3), world frame: against its velocity, and proportional to it.

    Besides, it is proportional to the density of the grass at the rover's
    centre and to the share of its height that stands in it. It is meant to act
    over one control step, which is too short for it to turn a rover round.
    """
    bottom = motion.position_w - robot.standing_height_m * motion.rotation[:, :, 2]
    force: Array = -grass.drag(bottom, robot.height_m)[:, None] * motion.velocity_w
    return force
