"""The forces of the behaviour `social_force`, compiled.

Helbing & Molnár, "Social force model for pedestrian dynamics" (1995), with the interaction that Moussaïd et
al., "Experimental study of the behavioural mechanisms underlying self-organization in human crowds" (2009),
measured, and the factors of HuNavSim and its library lightsfm. Forces are per unit of mass [m/s²].
PySocialForce has the same interaction. What differs: people are repelled by the one nearest obstacle point;
bodies that touch are pressed apart (Helbing, Farkas & Vicsek 2000, with a softer spring that steps of 0.05 s
can follow); there are no forces of walking groups.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

_SIGHT_M = 8.0
_RELAXATION_S = 0.5
# Of the interaction (Moussaïd et al. 2009): weight of velocities, range per length, and angular ranges.
_LAMBDA, _GAMMA, _N, _N_PRIME = 2.0, 0.35, 2.0, 3.0
# Of obstacles: factor [m/s²] and range [m].
_OBSTACLE, _OBSTACLE_RANGE_M = 10.0, 0.2
# Of bodies that touch [1/s²].
_SPRING = 60.0


@compile_function
def interact(apart: Any, own: Any, other: Any, factor: float, force: Any) -> None:
    """Add to `force` (2,) what an agent at velocity `own` feels of one `apart` (2,) at velocity `other`."""
    distance = max(np.hypot(apart[0], apart[1]), 1e-6)
    ex, ey = apart[0] / distance, apart[1] / distance
    dx, dy = _LAMBDA * (own[0] - other[0]) + ex, _LAMBDA * (own[1] - other[1]) + ey
    length = max(np.hypot(dx, dy), 1e-6)
    tx, ty = dx / length, dy / length
    theta = np.arctan2(tx * ey - ty * ex, tx * ex + ty * ey)
    reach = _GAMMA * length
    slow = factor * np.exp(-distance / reach - (_N_PRIME * reach * theta) ** 2)
    turn = factor * np.sign(theta) * np.exp(-distance / reach - (_N * reach * theta) ** 2)
    # Against the direction of the interaction, and to its side.
    force[0] += -slow * tx + turn * ty
    force[1] += -slow * ty - turn * tx


@compile_function
def repel(distance_m: float, direction: Any, force: Any) -> None:
    """Add to `force` (2,) what an obstacle at `distance_m` in `direction` (2,) does."""
    size = _OBSTACLE * np.exp(-distance_m / _OBSTACLE_RANGE_M)
    force[0] -= size * direction[0]
    force[1] -= size * direction[1]


@compile_function
def add_social_forces(
    position: Any, velocity: Any, reach: Any, is_obstacle: Any, first: int, obstacle_distance: Any,
    obstacle_direction: Any, wanted: Any, factors: Any, found: Any,
) -> None:  # fmt: skip
    """Forces `found` (M, G, 2) [m/s²] on the agents, which want the velocities `wanted` (M, G, 2) [m/s].

    `position`, `velocity` (M, K, 2) and `reach` (K,) [m] are those of all bodies; the agents are the G bodies
    from `first` on. Bodies with `is_obstacle` (K,) are felt as obstacles. `factors` are those of the wanted
    velocity and of others.
    """
    of_goal, of_others = factors
    apart, direction = np.empty(2), np.empty(2)
    for scene in range(len(position)):
        for agent in range(wanted.shape[1]):
            me, force = first + agent, found[scene, agent]
            own = velocity[scene, me]
            for axis in range(2):
                force[axis] += of_goal * (wanted[scene, agent, axis] - own[axis]) / _RELAXATION_S
            for other in range(position.shape[1]):
                if other == me:
                    continue
                apart[0] = position[scene, other, 0] - position[scene, me, 0]
                apart[1] = position[scene, other, 1] - position[scene, me, 1]
                distance = np.hypot(apart[0], apart[1])
                if distance > _SIGHT_M:
                    continue
                gap = distance - reach[me] - reach[other]
                direction[0], direction[1] = apart[0] / max(distance, 1e-6), apart[1] / max(distance, 1e-6)
                if is_obstacle[other]:
                    repel(gap, direction, force)
                else:
                    interact(apart, own, velocity[scene, other], of_others, force)
                if gap < 0.0:
                    force[0] += _SPRING * gap * direction[0]
                    force[1] += _SPRING * gap * direction[1]
            repel(obstacle_distance[scene, agent] - reach[me], obstacle_direction[scene, agent], force)
