"""The loops of model-predictive path integral control over rows, samples, times and points, compiled.

`vehicle` is (lowest speed [m/s], highest, largest yaw rate [rad/s], smallest turning radius [m], half the
length [m], half the width). `weights` is (of the way left to the goal at the end [1/m], of that on the way
[1/(m s)], of contact [1/s], of nearness [1/s], of driving backwards [1/m], of turning [s/rad²]). `margins_m`
are the distances from the outline at which nearness of returns and of movers begins to cost, `temperature` is
that of the samples' weights. `movers` (K, 5) are discs in motion: x, y, velocity and radius.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.planar import length
from dune_rl.sensors.perception.ways import way_left

_ARRIVED_M = 0.3
# Closer than this to a return counts as contact: segments and responses are no more exact.
_TOUCHING_M = 0.08
_YAW_ACCELERATION_RADPS2 = 4.0


@compile_function
def _clip_control(control: Any, vehicle: Any) -> Any:
    """A speed and a yaw rate within the vehicle's limits."""
    speed = min(max(control[0], vehicle[0]), vehicle[1])
    turn = min(max(control[1], -vehicle[2]), vehicle[2])
    if vehicle[3] > 0.0:
        tightest = abs(speed) / vehicle[3]
        turn = min(max(turn, -tightest), tightest)
    return speed, turn


@compile_function
def _distance_to_points(
    x: float, y: float, yaw: float, points: Any, vehicle: Any, farthest_m: float
) -> float:
    """Distance [m] of the vehicle's rectangle from the nearest of `points` (P, 2), up to a limit."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    nearest = farthest_m * farthest_m
    for point in range(len(points)):
        away_x, away_y = points[point, 0] - x, points[point, 1] - y
        ahead = max(abs(cos * away_x + sin * away_y) - vehicle[4], 0.0)
        aside = max(abs(cos * away_y - sin * away_x) - vehicle[5], 0.0)
        nearest = min(nearest, ahead * ahead + aside * aside)
    distance: float = np.sqrt(nearest)
    return distance


@compile_function
def _distance_to_movers(x: float, y: float, yaw: float, time: float, movers: Any, vehicle: Any) -> float:
    """Distance [m] of the vehicle's rectangle from the nearest of `movers` (K, 5) after a time [s]."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    nearest = np.inf
    for mover in movers:
        away_x, away_y = mover[0] + time * mover[2] - x, mover[1] + time * mover[3] - y
        ahead = max(abs(cos * away_x + sin * away_y) - vehicle[4], 0.0)
        aside = max(abs(cos * away_y - sin * away_x) - vehicle[5], 0.0)
        nearest = min(nearest, length(ahead, aside) - mover[4])
    return nearest


@compile_function
def rollout_cost(
    controls: Any, twist: Any, goal: Any, points: Any, movers: Any, way: Any, vehicle: Any, weights: Any,
    margins_m: Any, model: Any,
) -> float:  # fmt: skip
    """Cost of `controls` (H, 2: speed, yaw rate) from the origin, by a unicycle model with lags.

    `model` is (time of a step [s], time constant of both responses [s]); `twist` (2,) is the present speed
    and yaw rate; `goal` (2,), `points` (P, 2) [m] and `movers` are in the vehicle's frame. `way` is (pose of
    the odometry, map of the ways to the goal, its origin).
    """
    step_s, lag_s = model
    pose, ways, origin = way
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    left = 0.0
    share = min(1.0, step_s / lag_s)
    x, y, yaw = 0.0, 0.0, 0.0
    speed, turn = twist[0], twist[1]
    cost = 0.0
    for step in range(len(controls)):
        wanted_speed, wanted_turn = _clip_control(controls[step], vehicle)
        speed += share * (wanted_speed - speed)
        change = _YAW_ACCELERATION_RADPS2 * step_s
        turn += min(max(share * (wanted_turn - turn), -change), change)
        yaw += 0.5 * turn * step_s
        x += speed * step_s * np.cos(yaw)
        y += speed * step_s * np.sin(yaw)
        yaw += 0.5 * turn * step_s
        apart = _distance_to_points(x, y, yaw, points, vehicle, margins_m[0])
        if apart < margins_m[0]:
            cost += weights[3] * step_s * (1.0 - apart / margins_m[0]) ** 2
            if apart <= _TOUCHING_M:
                cost += weights[2] * step_s
        if len(movers):
            apart = _distance_to_movers(x, y, yaw, (step + 1) * step_s, movers, vehicle)
            if apart < margins_m[1]:
                cost += weights[3] * step_s * (1.0 - max(apart, 0.0) / margins_m[1]) ** 2
                if apart <= 0.0:
                    cost += weights[2] * step_s
        if length(goal[0] - x, goal[1] - y) < _ARRIVED_M:
            return cost
        left = way_left(ways, origin, pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y)
        cost += step_s * weights[1] * left
        cost += weights[4] * step_s * max(0.0, -speed) + weights[5] * step_s * turn * turn
    result: float = cost + weights[0] * left
    return result


@compile_function
def update_controls(
    nominal: Any, noise: Any, twists: Any, goals: Any, points: Any, counts: Any, movers: Any,
    mover_counts: Any, way: Any, vehicle: Any, weights: Any, margins_m: Any, model: Any, temperature: float,
) -> None:  # fmt: skip
    """One iteration of path integral control for each row, which changes `nominal` (N, H, 2).

    `noise` (N, S, H, 2) is added to the nominal controls: S samples for each row. `points` (N, P, 2) [m] are
    obstacles in the vehicles' frames, of which row n has `counts[n]`, `movers` (N, K, 5) discs in motion, of
    which it has `mover_counts[n]`. Samples are weighted by their costs as
    in Williams et al. (2017), without the term of the control's own cost.
    """
    samples, horizon = noise.shape[1], noise.shape[2]
    costs = np.empty(samples)
    controls = np.empty((horizon, 2))
    for row in range(len(nominal)):
        own, others = points[row, : counts[row]], movers[row, : mover_counts[row]]
        own_way = way[0][row], way[1][row], way[2][row]
        for sample in range(samples):
            for step in range(horizon):
                controls[step, 0] = nominal[row, step, 0] + noise[row, sample, step, 0]
                controls[step, 1] = nominal[row, step, 1] + noise[row, sample, step, 1]
            costs[sample] = rollout_cost(
                controls, twists[row], goals[row], own, others, own_way, vehicle, weights, margins_m, model
            )
        lowest = costs.min()
        total = 0.0
        controls[:] = 0.0
        for sample in range(samples):
            weight = np.exp(-(costs[sample] - lowest) / temperature)
            total += weight
            for step in range(horizon):
                controls[step, 0] += weight * noise[row, sample, step, 0]
                controls[step, 1] += weight * noise[row, sample, step, 1]
        for step in range(horizon):
            nominal[row, step, 0] += controls[step, 0] / total
            nominal[row, step, 1] += controls[step, 1] / total
            speed, turn = _clip_control(nominal[row, step], vehicle)
            nominal[row, step, 0], nominal[row, step, 1] = speed, turn
