"""The dynamic-window follower's loops over rows, commands and times, compiled.

`vehicle`, of `window_vehicle`, is (lowest speed [m/s], highest, largest yaw rate [rad/s], smallest turning
radius [m], distance [m] of the outer discs from the origin, the discs' radius [m], radius of the circle round
all [m], room [m] to keep beside static obstacles, and what it costs to have none [m/s], standard deviation of
gaps to what moves: now [m], and its growth [m/s]; 0: they are exact).
`response` is (largest acceleration [m/s²], largest yaw acceleration [rad/s²]). A grid is (x [m] and y of its
first cell's centre, cells per metre, number of rows, number of columns), its values row after row.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.planar import length
from dune_rl.state.unicycle import Unicycle

# `response`: how fast a body follows commands.
RESPONSE = 3.0, 4.0
# Three discs, about the middles of the thirds of the footprint's length, cover its rectangle.
_DISCS = 3
_SPEEDS = 9
_REVERSE_SPEEDS = 4
_YAW_RATES = 15
STEP_S = 0.1
# Of a look ahead of 2.5 s; drivers may look further.
STEPS = 25
# A command turns for this long, and then goes on turning or straight on.
_TURN_STEPS = 7
# Costs are in metres of level way. That of a contact with a moving body falls with its time, as actors turn.
_HIT_COST = 60.0
_HIT_DECAY_S = 1.5
# Gaps of more standard deviations than this hold.
_LIKELY = 3.0
# A contact with an obstacle that comes later than this can be avoided by braking: the way ends before it.
_BRAKE_S = 0.6
_BLOCKED_COST = 0.5
_NEAR_COST_PER_S = 2.5
_TOUCHING_COST_PER_S = 6.0
_TOUCHING_M = 0.05
_DEEPER_M = 0.03
_NEAR_STATIC_M = 0.45
_NEAR_ACTOR_M = 0.9
# Bounds of costs are lower by this, for rounding.
_ROUNDING_M = 1e-3
_REVERSE_COST_PER_M = 1.0
_TURN_COST = 0.05
# Facing away from the route is worth twice this.
_FACING_M = 0.7
_ARRIVED_M = 0.3


class Situation(NamedTuple):
    """What the loops read of N rows, in one frame: their first arguments, as `choose_commands` has them."""

    poses: Array
    twists: Array
    grids: Array
    fields: Floats
    waypoints: Any
    clearances: Floats
    actors: Array
    places: Array
    goals: Array
    vehicle: tuple[float, ...]
    response: tuple[float, float]
    recovering: Flags


def window_vehicle(
    vehicle: Unicycle,
    margin: tuple[float, float],
    speed_mps: float = math.inf,
    gap_error: tuple[float, float] = (0.0, 0.0),
) -> tuple[float, ...]:
    """The numbers that the loops read of a vehicle, which is to be no faster than `speed_mps`.

    `margin` is the room to keep beside static obstacles [m], and what it costs to have none [m/s];
    `gap_error` the standard deviation of gaps to what moves now [m], and its growth [m/s].
    """
    reach = vehicle.length_m / _DISCS
    return (
        max(vehicle.min_speed_mps, -speed_mps),
        min(vehicle.max_speed_mps, speed_mps),
        vehicle.max_yaw_rate_radps,
        vehicle.turning_radius_m,
        reach,
        math.hypot(reach / 2, vehicle.width_m / 2),
        vehicle.footprint_radius_m,
        *margin,
        *gap_error,
    )


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
def _misalignment(grid: Any, waypoints: Any, x: float, y: float, yaw: float) -> float:
    """1 - cos of the angle between a yaw and the route's direction at a point: from 0 to 2."""
    rows, columns = np.int64(grid[3]), np.int64(grid[4])
    column = np.int64(min(max((x - grid[0]) * grid[2] + 0.5, 0.0), columns - 1.0))
    row = np.int64(min(max((y - grid[1]) * grid[2] + 0.5, 0.0), rows - 1.0))
    waypoint = waypoints[row * columns + column]
    ahead_x = grid[0] + (waypoint % columns) / grid[2] - x
    ahead_y = grid[1] + (waypoint // columns) / grid[2] - y
    distance = length(ahead_x, ahead_y)
    if distance < 1e-6:
        return 0.0
    result: float = 1.0 - (ahead_x * np.cos(yaw) + ahead_y * np.sin(yaw)) / distance
    return result


@compile_function
def predict_actors(actors: Any, places: Any) -> None:
    """Future `places` (N, T, K, 2) of `actors` (N, K, 6: x, y, velocity, yaw rate, radius).

    They turn for 1 s, and go straight on from then.
    """
    for row in range(len(actors)):
        for number in range(actors.shape[1]):
            actor = actors[row, number]
            x, y = actor[0], actor[1]
            speed = length(actor[2], actor[3])
            course = np.arctan2(actor[3], actor[2])
            for step in range(places.shape[1]):
                if step * STEP_S < 1.0:
                    course += actor[4] * STEP_S
                x += speed * STEP_S * np.cos(course)
                y += speed * STEP_S * np.sin(course)
                places[row, step, number, 0], places[row, step, number, 1] = x, y


@compile_function
def _gaps(
    x: float, y: float, yaw: float, grid: Any, clearance: Any, places: Any, actors: Any, vehicle: Any
) -> Any:
    """Distances [m] of the vehicle's discs from obstacles and from actors; bounds where these are far."""
    reach, radius, around = vehicle[4], vehicle[5], vehicle[6]
    static, moving = interpolate_grid(grid, clearance, x, y) - around, np.inf
    for number in range(len(places)):
        apart = length(places[number, 0] - x, places[number, 1] - y) - actors[number, 5] - around
        moving = min(moving, apart)
    if static > _NEAR_STATIC_M and moving > _NEAR_ACTOR_M:
        return static, moving
    static, moving = np.inf, np.inf
    cos, sin = np.cos(yaw), np.sin(yaw)
    for side in (-1.0, 0.0, 1.0):
        disc_x, disc_y = x + side * reach * cos, y + side * reach * sin
        static = min(static, interpolate_grid(grid, clearance, disc_x, disc_y) - radius)
        for number in range(len(places)):
            apart = length(places[number, 0] - disc_x, places[number, 1] - disc_y)
            moving = min(moving, apart - actors[number, 5] - radius)
    return static, moving


@compile_function
def _wait_cost(
    x: float, y: float, yaw: float, since: int, maps: Any, places: Any, actors: Any, vehicle: Any
) -> float:
    """Cost of standing at a pose from a step on: actors may come."""
    for step in range(since, len(places)):
        _, moving = _gaps(x, y, yaw, maps[0], maps[3], places[step], actors, vehicle)
        if moving <= 0.0:
            cost: float = _HIT_COST * np.exp(-(step + 1) * STEP_S / _HIT_DECAY_S)
            return cost
    return 0.0


@compile_function
def _reach(twist: Any, vehicle: Any, steps: int) -> float:
    """The farthest [m] that a vehicle comes within a look ahead of `steps`."""
    result: float = steps * STEP_S * max(-vehicle[0], vehicle[1], abs(twist[0]))
    return result


@compile_function
def _least_left(pose: Any, goal: Any, grid: Any, field: Any, reach: float) -> float:
    """The least that can be left at the end of a look ahead that comes `reach` [m] far; 0 near the goal."""
    if length(goal[0] - pose[0], goal[1] - pose[1]) < reach + _ARRIVED_M + _ROUNDING_M:
        return 0.0
    rows, columns = np.int64(grid[3]), np.int64(grid[4])
    column, row = (pose[0] - grid[0]) * grid[2], (pose[1] - grid[1]) * grid[2]
    cells = reach * grid[2] + 1.0
    left = np.int64(min(max(column - cells, 0.0), columns - 1.0))
    right = np.int64(min(max(column + cells, 0.0), columns - 1.0))
    bottom = np.int64(min(max(row - cells, 0.0), rows - 1.0))
    top = np.int64(min(max(row + cells, 0.0), rows - 1.0))
    least = np.inf
    for line in range(bottom, top + 1):
        for cell in range(line * columns + left, line * columns + right + 1):
            least = min(least, field[cell])
    return least - _ROUNDING_M


@compile_function
def _in_reach(pose: Any, actors: Any, places: Any, vehicle: Any, reach: float) -> Any:
    """The `actors` (K, 6) and `places` (T, K, 2) that a look ahead `reach` [m] far may come near to."""
    around = max(vehicle[6], vehicle[4] + vehicle[5])
    near = max(_NEAR_ACTOR_M, _LIKELY * (vehicle[9] + vehicle[10] * len(places) * STEP_S))
    numbers, count = np.empty(len(actors), np.int64), 0
    for number in range(len(actors)):
        limit = reach + around + near + actors[number, 5] + _ROUNDING_M
        for step in range(len(places)):
            if length(places[step, number, 0] - pose[0], places[step, number, 1] - pose[1]) < limit:
                numbers[count] = number
                count += 1
                break
    return actors[numbers[:count]], places[:, numbers[:count]]


@compile_function
def _command_cost(
    pose: Any, twist: Any, command: Any, maps: Any, places: Any, actors: Any, goal: Any, vehicle: Any,
    response: Any, recovers: bool, least_left: float, best: float,
) -> float:  # fmt: skip
    """Cost of a command (speed, yaw rate, yaw rate after 0.7 s) for the T steps of `places` (T, K, 2); inf
    where it exceeds `best`.

    At least `least_left` is left at the end, unless it `recovers`.

    Where gaps to what moves are not exact, the largest expected cost of a contact is added.
    """
    grid, field, waypoints, clearance = maps
    x, y, yaw = pose[0], pose[1], pose[2]
    speed, turn = twist[0], twist[1]
    static, moving = _gaps(x, y, yaw, grid, clearance, places[0], actors, vehicle)
    # Who touches already pays for the time until it is out, but hits only what it goes deeper into.
    static_limit = static - _DEEPER_M if static <= 0.0 else 0.0
    moving_limit = moving - _DEEPER_M if moving <= 0.0 else 0.0
    near, travelled, risk = 0.0, 0.0, 0.0
    for step in range(len(places)):
        wanted_turn = command[1] if step < _TURN_STEPS else command[2]
        change, turn_change = response[0] * STEP_S, response[1] * STEP_S
        speed += min(max(command[0] - speed, -change), change)
        turn += min(max(wanted_turn - turn, -turn_change), turn_change)
        last_x, last_y, last_yaw = x, y, yaw
        yaw += 0.5 * turn * STEP_S
        x += speed * STEP_S * np.cos(yaw)
        y += speed * STEP_S * np.sin(yaw)
        yaw += 0.5 * turn * STEP_S
        travelled += abs(speed) * STEP_S
        time = (step + 1) * STEP_S
        static, moving = _gaps(x, y, yaw, grid, clearance, places[step], actors, vehicle)
        if moving <= 0.0:
            if moving <= moving_limit:
                risk = max(risk, _HIT_COST * np.exp(-time / _HIT_DECAY_S))
                break
            near += _TOUCHING_COST_PER_S * STEP_S * (1.0 - moving / _TOUCHING_M)
        if static <= 0.0:
            if static <= static_limit:
                if time < _BRAKE_S:
                    near += _HIT_COST * (2.0 - time / _BRAKE_S)
                else:
                    near += _BLOCKED_COST + _wait_cost(
                        last_x, last_y, last_yaw, step, maps, places, actors, vehicle
                    )
                x, y, yaw = last_x, last_y, last_yaw
                break
            near += _TOUCHING_COST_PER_S * STEP_S * (1.0 - static / _TOUCHING_M)
        spread = vehicle[9] + vehicle[10] * time
        if spread > 0.0 and moving < _LIKELY * spread:
            chance = 0.5 * math.erfc(max(moving, 0.0) / (math.sqrt(2.0) * spread))
            risk = max(risk, chance * _HIT_COST * np.exp(-time / _HIT_DECAY_S))
        pace = 0.3 + abs(speed)
        near += _NEAR_COST_PER_S * pace * STEP_S * max(0.0, 1.0 - max(static, 0.0) / _NEAR_STATIC_M) ** 2
        near += vehicle[8] * STEP_S * max(0.0, 1.0 - max(static, 0.0) / vehicle[7])
        near += _NEAR_COST_PER_S * STEP_S * max(0.0, 1.0 - max(moving, 0.0) / _NEAR_ACTOR_M) ** 2
        if near + risk + least_left > best and not recovers:
            return np.inf
        if not recovers and length(goal[0] - x, goal[1] - y) < _ARRIVED_M:
            return near + risk + 0.1 * time
    near += risk
    near += _TURN_COST * abs(command[1])
    if recovers:
        return near - length(x - pose[0], y - pose[1])
    near += interpolate_grid(grid, field, x, y) + _FACING_M * _misalignment(grid, waypoints, x, y, yaw)
    return near + (_REVERSE_COST_PER_M * travelled if command[0] < 0.0 else 0.0)


@compile_function
def choose_commands(
    poses: Any, twists: Any, grids: Any, fields: Any, waypoints: Any, clearances: Any, actors: Any,
    places: Any, goals: Any, vehicle: Any, response: Any, recovering: Any, found: Any,
) -> None:  # fmt: skip
    """The cheapest speed [m/s] and yaw rate [rad/s] of each row, `found` (N, 2).

    `poses` (N, 3: x, y, yaw), `twists` (N, 2: speed, yaw rate), `grids` (N, 5), cost-to-go `fields`, next
    `waypoints` (numbers of cells) and `clearances` (N, C), `actors` (N, K, 6: x, y, their velocities, yaw
    rates, radius) and their future `places` (N, T, K, 2), `goals` (N, 2). Rows that are `recovering` (N,) get
    away from where they are instead.
    """
    command = np.empty(3)
    for row in range(len(poses)):
        best = np.inf
        maps = grids[row], fields[row], waypoints[row], clearances[row]
        reach = _reach(twists[row], vehicle, places.shape[1])
        least_left = _least_left(poses[row], goals[row], grids[row], fields[row], reach)
        near_actors, near_places = _in_reach(poses[row], actors[row], places[row], vehicle, reach)
        for speed_number in range(-_REVERSE_SPEEDS, _SPEEDS):
            if speed_number < 0:
                speed = vehicle[0] * -speed_number / _REVERSE_SPEEDS
            else:
                speed = vehicle[1] * speed_number / (_SPEEDS - 1)
            if speed_number < 0 and speed >= 0.0:
                continue
            for turn_number in range(_YAW_RATES):
                share = 2.0 * turn_number / (_YAW_RATES - 1) - 1.0
                # Finer near 0.
                turn = vehicle[2] * share * abs(share)
                if vehicle[3] > 0.0:
                    tightest = abs(speed) / vehicle[3]
                    turn = min(max(turn, -tightest), tightest)
                for then in range(2):
                    if then == 1 and turn == 0.0:
                        continue
                    command[0], command[1] = speed, turn
                    command[2] = 0.0 if then == 0 else turn
                    cost = _command_cost(
                        poses[row], twists[row], command, maps, near_places, near_actors, goals[row], vehicle,
                        response, recovering[row], least_left, best,
                    )  # fmt: skip
                    if cost < best:
                        best = cost
                        found[row, 0], found[row, 1] = speed, turn


@compile_function
def score_commands(
    poses: Any, twists: Any, grids: Any, fields: Any, waypoints: Any, clearances: Any, actors: Any,
    places: Any, goals: Any, vehicle: Any, response: Any, recovering: Any, commands: Any, likely: Any,
    cap: float, costs: Any,
) -> None:  # fmt: skip
    """Costs (N, C) of `commands` (C, 2: speed [m/s], yaw rate [rad/s]) in each row, as `choose_commands`.

    A cost that is `cap` above the least is inf. `likely` (N,) are numbers of commands that may be cheap.
    """
    command = np.empty(3)
    for row in range(len(poses)):
        best = np.inf
        maps = grids[row], fields[row], waypoints[row], clearances[row]
        reach = _reach(twists[row], vehicle, places.shape[1])
        least_left = _least_left(poses[row], goals[row], grids[row], fields[row], reach)
        near_actors, near_places = _in_reach(poses[row], actors[row], places[row], vehicle, reach)
        for order in range(-1, len(commands)):
            number = likely[row] % len(commands) if order < 0 else order
            if order == likely[row]:
                continue
            low = np.inf
            command[0], command[1] = commands[number, 0], commands[number, 1]
            if vehicle[3] > 0.0:
                tightest = abs(command[0]) / vehicle[3]
                command[1] = min(max(command[1], -tightest), tightest)
            for then in range(2):
                if then == 1 and command[1] == 0.0:
                    continue
                command[2] = 0.0 if then == 0 else command[1]
                cost = _command_cost(
                    poses[row], twists[row], command, maps, near_places, near_actors, goals[row], vehicle,
                    response, recovering[row], least_left, min(best + cap, low),
                )  # fmt: skip
                low = min(low, cost)
            costs[row, number] = low
            best = min(best, low)
