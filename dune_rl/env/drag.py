"""Drag of tall grass on robots."""

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.shared_per_scene import Rows, agent_rows
from dune_rl.robots.robot import Robot
from dune_rl.state.state import Motion
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.grass import Grass

_ALL = slice(None)


def drag_forces(sites: BatchedWorlds, motion: Motion, robot: Robot, count: int = 1) -> Array | None:
    """Force [N] of the grass on each robot, (M * `count`, 3), world frame; None where no grass grows."""
    groups = sites.worlds.groups
    if all(world.grass is None for world, _ in groups):
        return None
    force = np.zeros_like(motion.velocity_w)
    for world, rows in groups:
        if world.grass is not None:
            rows = agent_rows(rows, count)
            force[rows] = grass_force(world.grass, motion, robot, rows)
    return force


def grass_force(grass: Grass, motion: Motion, robot: Robot, rows: Rows = _ALL) -> Array:
    """Force [N] on each robot of `rows`, world frame: against its velocity, and proportional to it.

    It is also proportional to the density of the grass at the robot's centre and
    to the share of the robot's height in the grass. It acts for one control
    step, which is too short to reverse the velocity.
    """
    bottom = motion.position_w[rows] - robot.standing_height_m * motion.rotation[rows, :, 2]
    force: Array = -grass.drag(bottom, robot.height_m)[:, None] * motion.velocity_w[rows]
    return force
