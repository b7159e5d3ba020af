"""What robots can touch in a control step, compiled: see `ContactGate` and `ObstacleMap`."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

# Columns of a robot: x and y of the centre of mass, speed, reach and acceleration [SI]; x and y, quaternion
# and angular velocity of the base link.
ROBOT_COLUMNS = 14
# Columns of a tyre: position in the base link's frame (3), its length, and the distance of the tyre's edge
# from it [m].
TYRE_COLUMNS = 5
# Columns of a kinematic body: x and y before and after the step, and the radius of a disc about them that
# contains it [m].
KINEMATIC_COLUMNS = 5
# Columns of a pose: x, y, z [m], yaw, roll and pitch [rad].
POSE_COLUMNS = 6
# Columns of what is found of a robot: x, y and radius [m] of its disc, whether it can touch anything, and the
# bits of its tyres, of which there may be 53: numbers are exact up to there.
FOUND_COLUMNS = 5


@compile_function
def find_distance(grid: Any, quarters: Any, x: float, y: float) -> float:
    """See `ObstacleMap.distance`: `grid` has its bounds [m], the cells' size [m] and the number of rows."""
    low_x, high_x, low_y, high_y, cell, rows = grid
    if not len(quarters):
        return np.inf
    inside_x, inside_y = min(max(x, low_x), high_x), min(max(y, low_y), high_y)
    column, row = np.int64((inside_x - low_x) / cell), np.int64((inside_y - low_y) / cell)
    near = 0.25 * cell * quarters[column * np.int64(rows) + row]
    if inside_x == x and inside_y == y:
        return near
    # Seen from the nearest point of the obstacles' convex bounding box, query and obstacles are in
    # directions at least 90 degrees apart.
    return np.hypot(np.hypot(x - inside_x, y - inside_y), near)


@compile_function
def find_boxes(boxes: Any, x: float, y: float, distance_m: float, found: Any) -> int:
    """Find the `boxes` (B, 4: xmin, ymin, xmax, ymax) within a distance along x and y; returns their number.

    Their indices are `found` (B,).
    """
    count = 0
    for index in range(len(boxes)):
        if (
            boxes[index, 0] < x + distance_m
            and boxes[index, 1] < y + distance_m
            and boxes[index, 2] > x - distance_m
            and boxes[index, 3] > y - distance_m
        ):
            found[count] = index
            count += 1
    return count


@compile_function
def measure_moves(old: Any, new: Any, reaches: Any, moves: Any) -> None:
    """Fill in `moves` (K, KINEMATIC_COLUMNS) of bodies that go from `old` to `new` (K, POSE_COLUMNS).

    `reaches` (K, 2) are the radii of the discs that hold them upright, and by how much these grow for each
    radian that they lean, up to one [m].
    """
    for body in range(len(moves)):
        moves[body, 0], moves[body, 1] = old[body, 0], old[body, 1]
        moves[body, 2], moves[body, 3] = new[body, 0], new[body, 1]
        # The sums bound the angles between their z axes and the world's.
        lean = max(abs(old[body, 4]) + abs(old[body, 5]), abs(new[body, 4]) + abs(new[body, 5]))
        moves[body, 4] = reaches[body, 0] + reaches[body, 1] * min(lean, 1.0)


@compile_function
def find_near(
    grid: Any,
    quarters: Any,
    robots: Any,
    tyres: Any,
    kinematics: Any,
    duration_s: float,
    margin_m: float,
    found_robots: Any,
    found_kinematics: Any,
) -> None:
    """Find what R robots and K kinematic bodies can touch in a control step of `duration_s`.

    `grid` and `quarters` are an obstacle map's. `robots` are (R, ROBOT_COLUMNS), their `tyres`
    (R, T, TYRE_COLUMNS), NaN where a robot has fewer; `kinematics` (K, KINEMATIC_COLUMNS).

    `found_robots` (R, FOUND_COLUMNS) are discs (x, y, radius) that contain all places of each robot in the
    step, whether it can touch anything, and which of its tyres can, as bits; `found_kinematics` (K,) tells
    which of the bodies can touch any.
    """
    for one in range(len(robots)):
        x, y, own = robots[one, 0], robots[one, 1], found_robots[one]
        span = robots[one, 3] + _find_motion(robots[one], duration_s) + margin_m
        own[0], own[1], own[2] = x, y, span
        # Written so that NaN, which compares false, counts as near.
        own[3] = not (np.isfinite(x + y) and find_distance(grid, quarters, x, y) >= span)
        for other in range(one):
            theirs = found_robots[other]
            if not np.hypot(x - theirs[0], y - theirs[1]) > span + theirs[2]:
                own[3] = theirs[3] = 1.0
    for body in range(len(kinematics)):
        found_kinematics[body] = 0.0
        x, y, room = _find_room(kinematics[body])
        for one in range(len(robots)):
            disc = found_robots[one]
            if not np.hypot(x - disc[0], y - disc[1]) > disc[2] + room:
                found_kinematics[body] = disc[3] = 1.0
    for one in range(len(robots)):
        own, robot = found_robots[one], robots[one]
        own[4] = 0.0
        x, y, qx, qy, qz, qw = robot[5], robot[6], robot[7], robot[8], robot[9], robot[10]
        # A state that has diverged is near nothing.
        if not own[3] or not np.isfinite(x + y + qx + qy + qz + qw):
            continue
        motion = _find_motion(robot, duration_s)
        turn = np.sqrt(robot[11] ** 2 + robot[12] ** 2 + robot[13] ** 2) * duration_s
        forward_x, forward_y = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz)
        left_x, left_y = 2.0 * (qx * qy - qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz)
        up_x, up_y = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx)
        needed = 0
        for tyre in range(tyres.shape[1]):
            if np.isnan(tyres[one, tyre, 0]):
                continue
            ahead, aside, above = tyres[one, tyre, 0], tyres[one, tyre, 1], tyres[one, tyre, 2]
            arm, size = tyres[one, tyre, 3], tyres[one, tyre, 4]
            tyre_x = x + ahead * forward_x + aside * left_x + above * up_x
            tyre_y = y + ahead * forward_y + aside * left_y + above * up_y
            reach = size + motion + turn * arm + margin_m
            meets = find_distance(grid, quarters, tyre_x, tyre_y) < reach
            for body in range(len(kinematics)):
                if found_kinematics[body]:
                    body_x, body_y, room = _find_room(kinematics[body])
                    meets = meets or np.hypot(tyre_x - body_x, tyre_y - body_y) < reach + room
            for other in range(len(robots)):
                apart = np.hypot(tyre_x - found_robots[other, 0], tyre_y - found_robots[other, 1])
                meets = meets or (other != one and apart < reach + found_robots[other, 2])
            needed |= int(meets) << tyre
        own[4] = needed


@compile_function
def _find_motion(robot: Any, duration_s: float) -> float:
    """Upper bound of the way [m] of a robot (ROBOT_COLUMNS) in a control step."""
    return float((robot[2] + robot[4] * duration_s / 2) * duration_s)


@compile_function
def _find_room(body: Any) -> Any:
    """Disc (x, y, radius) [m] that contains a body (KINEMATIC_COLUMNS) throughout a control step."""
    x, y = body[2], body[3]
    return x, y, body[4] + abs(x - body[0]) + abs(y - body[1])
