"""Optimal reciprocal collision avoidance (ORCA) of the agents of M scenes, compiled.

After van den Berg, Guy, Lin & Manocha, "Reciprocal n-body collision avoidance" (2011). What differs from
their library RVO2: an obstacle is the half-plane of the nearest point of the clearance field, not a polygon;
the share that an agent has in avoiding each other one is a setting, 1/2 in RVO2; there is no tree of
neighbours, because a scene has tens of agents.
"""

from typing import Any

import numpy as np

from dune_rl.behaviours.avoidance.half_planes import fit_velocity
from dune_rl.geometry.compiled import compile_function

# Half-planes of other agents; the nearest ones.
_MOST_NEIGHBOURS = 10


@compile_function
def _add_agent_plane(
    apart: Any, own: Any, other: Any, reach: float, share: float, horizon_s: float, step_s: float, plane: Any
) -> None:
    """The half-plane (4,) of an agent at velocity `own` (2,) against one `apart` (2,) at velocity `other`.

    `reach` is the sum of the radii [m], `share` the part of the change of velocity that the agent makes.
    """
    px, py = apart
    vx, vy = own[0] - other[0], own[1] - other[1]
    distance2 = px * px + py * py
    if distance2 > reach * reach:
        wx, wy = vx - px / horizon_s, vy - py / horizon_s
        length2 = wx * wx + wy * wy
        ahead = wx * px + wy * py
        if ahead < 0.0 and ahead * ahead > reach * reach * length2:
            # The nearest border of the velocity obstacle is its round end.
            length = np.sqrt(length2)
            nx, ny = wx / length, wy / length
            plane[2], plane[3] = ny, -nx
            ux, uy = (reach / horizon_s - length) * nx, (reach / horizon_s - length) * ny
        else:
            leg = np.sqrt(distance2 - reach * reach)
            if px * wy - py * wx > 0.0:
                dx, dy = (px * leg - py * reach) / distance2, (px * reach + py * leg) / distance2
            else:
                dx, dy = -(px * leg + py * reach) / distance2, -(py * leg - px * reach) / distance2
            along = vx * dx + vy * dy
            plane[2], plane[3] = dx, dy
            ux, uy = along * dx - vx, along * dy - vy
    else:
        # They overlap: apart within a step.
        wx, wy = vx - px / step_s, vy - py / step_s
        length = np.sqrt(wx * wx + wy * wy)
        nx, ny = (wx / length, wy / length) if length > 0.0 else (1.0, 0.0)
        plane[2], plane[3] = ny, -nx
        ux, uy = (reach / step_s - length) * nx, (reach / step_s - length) * ny
    plane[0], plane[1] = own[0] + share * ux, own[1] + share * uy


@compile_function
def avoid_collisions(
    position: Any,
    velocity: Any,
    reach: Any,
    share: Any,
    first: int,
    obstacle_distance: Any,
    obstacle_direction: Any,
    wanted: Any,
    limit: Any,
    sight_m: float,
    horizons_s: Any,
    step_s: float,
    found: Any,
) -> None:
    """Velocities `found` (M, G, 2) [m/s] near the `wanted` ones, at which the agents collide with nobody.

    `position`, `velocity` (M, K, 2) and `reach` (K,) [m] are those of all bodies; the agents are the G bodies
    from `first` on. `share` (K,) is an agent's part in avoiding each body, 0 for bodies to be ignored.
    `obstacle_distance` (M, G) and `obstacle_direction` (M, G, 2) are those of the nearest obstacle. `limit`
    (M, G) are the highest speeds. `horizons_s` are the times that agents look ahead to others, and to
    obstacles.
    """
    horizon_s, obstacle_horizon_s = horizons_s
    bodies = position.shape[1]
    planes, work = np.empty((_MOST_NEIGHBOURS + 1, 4)), np.empty((_MOST_NEIGHBOURS + 1, 4))
    nearest, distances = np.empty(_MOST_NEIGHBOURS, np.int64), np.empty(_MOST_NEIGHBOURS)
    apart = np.empty(2)
    for scene in range(len(position)):
        for agent in range(wanted.shape[1]):
            me = first + agent
            x, y = position[scene, me]
            count = 0
            for other in range(bodies):
                if other == me or share[other] == 0.0:
                    continue
                dx, dy = position[scene, other, 0] - x, position[scene, other, 1] - y
                distance = np.sqrt(dx * dx + dy * dy) - reach[me] - reach[other]
                if distance > sight_m or (count == _MOST_NEIGHBOURS and distance >= distances[count - 1]):
                    continue
                place = count if count < _MOST_NEIGHBOURS else count - 1
                while place > 0 and distances[place - 1] > distance:
                    distances[place], nearest[place] = distances[place - 1], nearest[place - 1]
                    place -= 1
                distances[place], nearest[place] = distance, other
                count = min(count + 1, _MOST_NEIGHBOURS)
            own = velocity[scene, me]
            hard = 0
            nx, ny = obstacle_direction[scene, agent]
            gap = obstacle_distance[scene, agent] - reach[me]
            if (nx != 0.0 or ny != 0.0) and gap < sight_m:
                most = max(gap / obstacle_horizon_s, -0.5 * limit[scene, agent])
                planes[0, 0], planes[0, 1], planes[0, 2], planes[0, 3] = most * nx, most * ny, -ny, nx
                hard = 1
            for number in range(count):
                other = nearest[number]
                apart[0], apart[1] = position[scene, other, 0] - x, position[scene, other, 1] - y
                _add_agent_plane(
                    apart, own, velocity[scene, other], reach[me] + reach[other], share[other],
                    horizon_s, step_s, planes[hard + number],
                )  # fmt: skip
            fit_velocity(
                planes, hard, hard + count, limit[scene, agent], wanted[scene, agent], work,
                found[scene, agent],
            )  # fmt: skip
