"""Optimal reciprocal collision avoidance (ORCA) of the agents of M scenes, compiled.

After van den Berg, Guy, Lin & Manocha, "Reciprocal n-body collision avoidance" (2011). What differs from
their library RVO2: an obstacle is the half-plane of the nearest point of the clearance field, not a polygon;
the share that an agent has in avoiding each other one is a setting, 1/2 in RVO2; there is no tree of
neighbours, because a scene has tens of agents.

Half-planes are rows (x, y, dx, dy): a point of the border, and its unit direction; velocities to the left of
it are permitted. The velocity is found by linear programs in two dimensions (section 5 of the paper; de Berg
et al., Computational Geometry, chapter 4): half-planes are added one after another, and where none fits all,
the velocity is the one that violates those of the agents least.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

# Half-planes of other agents; the nearest ones.
_MOST_NEIGHBOURS = 10
_PARALLEL = 1e-9


@compile_function
def _move_on_border(planes: Any, number: int, limit: float, aim: Any, is_direction: bool, found: Any) -> bool:
    """Set `found` (2,) to the best velocity on the border of a half-plane within those before it.

    The best is the one nearest to `aim`, or farthest along it. False where there is none: `found` stays.
    """
    x, y, dx, dy = planes[number]
    middle = x * dx + y * dy
    spread = middle * middle + limit * limit - (x * x + y * y)
    if spread < 0.0:
        return False
    first, last = -middle - np.sqrt(spread), -middle + np.sqrt(spread)
    for other in range(number):
        px, py, ex, ey = planes[other]
        slant = dx * ey - dy * ex
        beyond = ex * (y - py) - ey * (x - px)
        if abs(slant) <= _PARALLEL:
            if beyond < 0.0:
                return False
            continue
        place = beyond / slant
        if slant >= 0.0:
            last = min(last, place)
        else:
            first = max(first, place)
        if first > last:
            return False
    if is_direction:
        place = last if aim[0] * dx + aim[1] * dy > 0.0 else first
    else:
        place = min(max(dx * (aim[0] - x) + dy * (aim[1] - y), first), last)
    found[0], found[1] = x + place * dx, y + place * dy
    return True


@compile_function
def _fit_all(planes: Any, count: int, limit: float, aim: Any, is_direction: bool, found: Any) -> int:
    """Set `found` (2,) to the best velocity in the half-planes; the number of the first that fails."""
    length = np.hypot(aim[0], aim[1])
    scale = 1.0
    if is_direction or length > limit:
        scale = limit / length if length > 0.0 else 0.0
    found[0], found[1] = aim[0] * scale, aim[1] * scale
    for number in range(count):
        x, y, dx, dy = planes[number]
        if dx * (y - found[1]) - dy * (x - found[0]) > 0.0 and not _move_on_border(
            planes, number, limit, aim, is_direction, found
        ):
            return number
    return count


@compile_function
def fit_velocity(
    planes: Any, hard: int, count: int, limit: float, wanted: Any, work: Any, found: Any
) -> None:
    """Set `found` (2,) to the velocity nearest to `wanted`, at most `limit` fast, in `planes` (P, 4).

    The first `hard` of the `count` half-planes hold in any case, the others as well as they can together.
    `work` (P, 4) is overwritten.
    """
    failed = _fit_all(planes, count, limit, wanted, False, found)
    violation = 0.0
    aim, candidate = np.empty(2), np.empty(2)
    for number in range(failed, count):
        x, y, dx, dy = planes[number]
        if dx * (y - found[1]) - dy * (x - found[0]) <= violation:
            continue
        kept = 0
        for other in range(hard):
            work[kept] = planes[other]
            kept += 1
        # Where this plane is violated as much as another one: the border between the two.
        for other in range(hard, number):
            px, py, ex, ey = planes[other]
            slant = dx * ey - dy * ex
            if abs(slant) <= _PARALLEL:
                if dx * ex + dy * ey > 0.0:
                    continue
                work[kept, 0], work[kept, 1] = (x + px) / 2, (y + py) / 2
            else:
                place = (ex * (y - py) - ey * (x - px)) / slant
                work[kept, 0], work[kept, 1] = x + place * dx, y + place * dy
            length = np.hypot(ex - dx, ey - dy)
            if length <= _PARALLEL:
                continue
            work[kept, 2], work[kept, 3] = (ex - dx) / length, (ey - dy) / length
            kept += 1
        aim[0], aim[1] = -dy, dx
        if _fit_all(work, kept, limit, aim, True, candidate) == kept:
            found[0], found[1] = candidate[0], candidate[1]
        violation = dx * (y - found[1]) - dy * (x - found[0])


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
    position: Any, velocity: Any, reach: Any, share: Any, first: int, obstacle_distance: Any,
    obstacle_direction: Any, wanted: Any, limit: Any, sight_m: float, horizons_s: Any, step_s: float,
    found: Any,
) -> None:  # fmt: skip
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
