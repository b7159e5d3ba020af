"""The shield's loops over rows, commands, times and points, compiled.

`model` is (largest acceleration [m/s²], largest yaw rate [rad/s], yaw rate per radian of commanded heading
[1/s], smallest turning radius [m], half the length and half the width of the body [m]).
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.planar import length

STEP_S = 0.1
# A command is held for this many steps, and then the body brakes.
_HELD, _STEPS = 3, 10
_SPEED_SHARES = (1.0, 0.66, 0.33, 0.0)
_TURNS_RAD = (0.0, 0.35, -0.35, 0.7, -0.7)
# Of a command that differs: per share of the highest speed, and per radian.
_SPEED_COST, _TURN_COST = 1.0, 0.5
# A body that is closer than the margin may not come closer by more than this [m].
_CLOSER_M = 0.01


@compile_function
def _gap(x: float, y: float, yaw: float, point_x: float, point_y: float, model: Any) -> float:
    """Distance [m] of a point from the rectangle of the body at a pose; negative inside of it."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    away_x, away_y = point_x - x, point_y - y
    beyond_x = abs(cos * away_x + sin * away_y) - model[4]
    beyond_y = abs(cos * away_y - sin * away_x) - model[5]
    if beyond_x <= 0.0 or beyond_y <= 0.0:
        return max(beyond_x, beyond_y)
    result: float = length(beyond_x, beyond_y)
    return result


@compile_function
def _lowest_gap(
    speed: float, heading: float, twist: Any, points: Any, count: int, movers: Any, num_movers: int,
    model: Any,
) -> float:  # fmt: skip
    """Smallest gap [m] to `count` points at rest and to what moves, while a command is held and after."""
    turn = min(max(model[2] * heading, -model[1]), model[1])
    x, y, yaw, now = 0.0, 0.0, 0.0, twist[0]
    lowest = np.inf
    for step in range(_STEPS):
        wanted = speed if step < _HELD else 0.0
        now += min(max(wanted - now, -model[0] * STEP_S), model[0] * STEP_S)
        rate = turn if step < _HELD else 0.0
        if model[3] > 0.0:
            most = abs(now) / model[3]
            rate = min(max(rate, -most), most)
        yaw += 0.5 * rate * STEP_S
        x += now * STEP_S * np.cos(yaw)
        y += now * STEP_S * np.sin(yaw)
        yaw += 0.5 * rate * STEP_S
        if now != 0.0 or rate != 0.0:
            for number in range(count):
                lowest = min(lowest, _gap(x, y, yaw, points[number, 0], points[number, 1], model))
        time = (step + 1) * STEP_S
        for number in range(num_movers):
            mover = movers[number]
            gap = _gap(x, y, yaw, mover[0] + mover[2] * time, mover[1] + mover[3] * time, model)
            lowest = min(lowest, gap - mover[4])
    return lowest


@compile_function
def _present_gap(points: Any, count: int, movers: Any, num_movers: int, model: Any) -> float:
    lowest = np.inf
    for number in range(count):
        lowest = min(lowest, _gap(0.0, 0.0, 0.0, points[number, 0], points[number, 1], model))
    for number in range(num_movers):
        gap = _gap(0.0, 0.0, 0.0, movers[number, 0], movers[number, 1], model)
        lowest = min(lowest, gap - movers[number, 4])
    return lowest


@compile_function
def check_commands(
    commands: Any, twists: Any, points: Any, counts: Any, movers: Any, mover_counts: Any, model: Any,
    margin_m: float, top_speed_mps: float,
) -> None:  # fmt: skip
    """Change the `commands` (N, 2: speed, heading) that would touch something to the nearest that do not.

    `twists` (N, 2) are the present speeds and yaw rates. Row n has `counts[n]` of `points` (N, P, 2) at rest
    and `mover_counts[n]` of `movers` (N, K, 5: x, y, velocity, radius), in the bodies' frames. Where every
    command touches, it becomes the one that stays farthest away.
    """
    for row in range(len(commands)):
        twist, rests, count = twists[row], points[row], counts[row]
        moving, num_movers = movers[row], mover_counts[row]
        limit = min(margin_m, _present_gap(rests, count, moving, num_movers, model) - _CLOSER_M)
        speed, heading = commands[row, 0], commands[row, 1]
        found = _lowest_gap(speed, heading, twist, rests, count, moving, num_movers, model)
        if found >= limit:
            continue
        # To stop is always among the choices.
        least, farthest = np.inf, found
        for number in range(1 + len(_SPEED_SHARES) * len(_TURNS_RAD)):
            share, other = 0.0, 0.0
            if number > 0:
                share = _SPEED_SHARES[(number - 1) // len(_TURNS_RAD)]
                other = heading + _TURNS_RAD[(number - 1) % len(_TURNS_RAD)]
                other = min(max(other, -np.pi), np.pi)
            gap = _lowest_gap(share * speed, other, twist, rests, count, moving, num_movers, model)
            cost = _SPEED_COST * (1.0 - share) * abs(speed) / top_speed_mps
            cost += _TURN_COST * abs(other - heading)
            if gap >= limit and cost < least:
                least = cost
                commands[row, 0], commands[row, 1] = share * speed, other
            elif least == np.inf and gap > farthest:
                farthest = gap
                commands[row, 0], commands[row, 1] = share * speed, other
