"""Distances and times between the agents of a group and those of another, as compiled loops."""

import math
from typing import Any

from dune_rl.geometry.compiled import compile_function


@compile_function
def find_gaps(
    position: Any, reach: float, others: Any, per_scene: int, number: int, same: bool, found: Any
) -> None:
    """The smallest distance [m] of each agent from the others in its scene, where it is below `found` (N,).

    `position` (N, 2) [m] are those of `per_scene` agents in each scene, `others` (M * H, 2) those of `number`
    (H) agents; `reach` [m] is the sum of both radii. `same` says that they are one group, whose agents are
    not compared with themselves.
    """
    for row in range(len(position)):
        scene, agent = row // per_scene, row % per_scene
        for other in range(number):
            if same and other == agent:
                continue
            place = others[scene * number + other]
            gap = math.hypot(place[0] - position[row, 0], place[1] - position[row, 1]) - reach
            found[row] = min(found[row], gap)


@compile_function
def find_times_to_contact(
    position: Any,
    velocity: Any,
    reach: float,
    others: Any,
    velocities: Any,
    per_scene: int,
    number: int,
    same: bool,
    found: Any,
) -> None:
    """The shortest time [s] in which discs at constant velocities meet, where it is below `found` (N,).

    Arguments are as for `find_gaps`; `velocity` and `velocities` [m/s] are those of the agents and of the
    others. The time is 0 for discs that overlap.
    """
    for row in range(len(position)):
        scene, agent = row // per_scene, row % per_scene
        for other in range(number):
            if same and other == agent:
                continue
            index = scene * number + other
            x, y = others[index, 0] - position[row, 0], others[index, 1] - position[row, 1]
            u, v = velocities[index, 0] - velocity[row, 0], velocities[index, 1] - velocity[row, 1]
            apart = x * x + y * y - reach * reach
            if apart <= 0.0:
                found[row] = 0.0
                continue
            # |p + v t|^2 = reach^2, whose smaller root is the first contact.
            closing, square = -(x * u + y * v), u * u + v * v
            discriminant = closing * closing - square * apart
            if closing > 0.0 and discriminant >= 0.0:
                found[row] = min(found[row], apart / (closing + math.sqrt(discriminant)))
