"""The dynamic-window follower's loops over rows, arcs and times, compiled.

`vehicle` is (lowest speed [m/s], highest, largest yaw rate [rad/s], smallest turning radius [m], distance
[m] of the front and the rear disc from the origin, their radius [m]). `window` is (largest acceleration
[m/s²], largest yaw acceleration [rad/s²], time [s] in which they act). A grid is (x [m] and y of its first
cell's centre, cells per metre, number of rows, number of columns), its values row after row.
"""

from typing import Any

import numpy as np

from dune_rl.compiled import compile_function

_SPEEDS = 9
_YAW_RATES = 17
_STEP_S = 0.1
_STEPS = 20
# Costs are in metres of level way.
_HIT_COST = 100.0
_NEAR_COST_PER_S = 1.5
_NEAR_STATIC_M = 0.25
_NEAR_ACTOR_M = 0.7
_REVERSE_COST_PER_M = 0.5
_TURN_COST = 0.05
# Turning on the spot is worth what lies ahead.
_AHEAD_M = 0.5
_ARRIVED_M = 0.3


@compile_function
def interpolate_grid(grid: Any, values: Any, x: float, y: float) -> float:
    """Value at a point, between the centres of four cells; outside, that of the edge."""
    rows, columns = np.int64(grid[3]), np.int64(grid[4])
    right = min(max((x - grid[0]) * grid[2], 0.0), columns - 1.0)
    up = min(max((y - grid[1]) * grid[2], 0.0), rows - 1.0)
    column, row = min(np.int64(right), columns - 2), min(np.int64(up), rows - 2)
    right, up = right - column, up - row
    corner = row * columns + column
    low = values[corner] * (1.0 - right) + values[corner + 1] * right
    high = values[corner + columns] * (1.0 - right) + values[corner + columns + 1] * right
    result: float = low * (1.0 - up) + high * up
    return result


@compile_function
def _arc_cost(
    pose: Any, speed: float, yaw_rate: float, maps: Any, actors: Any, goal: Any, vehicle: Any
) -> float:
    """Cost of driving with a constant speed and yaw rate for 2 s."""
    grid, field, clearance = maps
    x, y, yaw = pose[0], pose[1], pose[2]
    reach, radius = vehicle[4], vehicle[5]
    near = 0.0
    for step in range(1, _STEPS + 1):
        yaw += 0.5 * yaw_rate * _STEP_S
        x += speed * _STEP_S * np.cos(yaw)
        y += speed * _STEP_S * np.sin(yaw)
        yaw += 0.5 * yaw_rate * _STEP_S
        time = step * _STEP_S
        static, moving = np.inf, np.inf
        for side in (-1.0, 1.0):
            disc_x, disc_y = x + side * reach * np.cos(yaw), y + side * reach * np.sin(yaw)
            static = min(static, interpolate_grid(grid, clearance, disc_x, disc_y) - radius)
            for actor in actors:
                apart_x, apart_y = actor[0] + actor[2] * time - disc_x, actor[1] + actor[3] * time - disc_y
                moving = min(moving, np.hypot(apart_x, apart_y) - radius - actor[4])
        if min(static, moving) <= 0.0:
            # The later the better: there is time left to change course.
            return _HIT_COST * (2.0 - time / (_STEPS * _STEP_S)) + near
        near += _NEAR_COST_PER_S * _STEP_S * max(0.0, 1.0 - static / _NEAR_STATIC_M) ** 2
        near += _NEAR_COST_PER_S * _STEP_S * max(0.0, 1.0 - moving / _NEAR_ACTOR_M) ** 2
        if np.hypot(goal[0] - x, goal[1] - y) < _ARRIVED_M:
            return near + 0.1 * time
    # Ahead of the nose, also in reverse: it turns round rather than drive backwards for long.
    left = interpolate_grid(grid, field, x + _AHEAD_M * np.cos(yaw), y + _AHEAD_M * np.sin(yaw))
    left += 0.2 * interpolate_grid(grid, field, x, y)
    backwards = _REVERSE_COST_PER_M * max(0.0, -speed) * _STEPS * _STEP_S
    return left + near + backwards + _TURN_COST * abs(yaw_rate)


@compile_function
def choose_arcs(
    poses: Any,
    twists: Any,
    grids: Any,
    fields: Any,
    clearances: Any,
    actors: Any,
    goals: Any,
    vehicle: Any,
    window: Any,
    found: Any,
) -> None:
    """The cheapest speed [m/s] and yaw rate [rad/s] of each row, `found` (N, 2).

    `poses` (N, 3: x, y, yaw), `twists` (N, 2: speed, yaw rate), `grids` (N, 5), cost-to-go `fields` and
    `clearances` (N, C), `actors` (N, K, 5: x, y, their velocities, radius), `goals` (N, 2).
    """
    gain, turn_gain = window[0] * window[2], window[1] * window[2]
    for row in range(len(poses)):
        best = np.inf
        slowest = max(vehicle[0], min(twists[row, 0] - gain, vehicle[1]))
        fastest = min(vehicle[1], max(twists[row, 0] + gain, vehicle[0]))
        rightmost = max(-vehicle[2], min(twists[row, 1] - turn_gain, 0.0))
        leftmost = min(vehicle[2], max(twists[row, 1] + turn_gain, 0.0))
        for speed_number in range(_SPEEDS + 1):
            # The last one is to stop.
            speed = slowest + (fastest - slowest) * speed_number / (_SPEEDS - 1)
            if speed_number == _SPEEDS:
                speed = min(max(0.0, slowest), fastest)
            for turn_number in range(_YAW_RATES + 1):
                turn = rightmost + (leftmost - rightmost) * turn_number / (_YAW_RATES - 1)
                if turn_number == _YAW_RATES:
                    turn = 0.0
                if vehicle[3] > 0.0:
                    tightest = abs(speed) / vehicle[3]
                    turn = min(max(turn, -tightest), tightest)
                maps = grids[row], fields[row], clearances[row]
                cost = _arc_cost(poses[row], speed, turn, maps, actors[row], goals[row], vehicle)
                if cost < best:
                    best = cost
                    found[row, 0], found[row, 1] = speed, turn
