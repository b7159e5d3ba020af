"""The loops of model-predictive path integral control over rows, samples, times and points, compiled.

`vehicle` is (lowest speed [m/s], highest, largest yaw rate [rad/s], smallest turning radius [m], half the
length [m], half the width). `weights` is (of the distance from the goal at the end [1/m], of that on the way
[1/(m s)], of contact [1/s], of nearness [1/s], of driving backwards [1/m], of turning [s/rad²]). `margin_m`
is the distance from the outline at which nearness begins to cost, `temperature` that of the samples' weights.
"""

from typing import Any

import numpy as np

from dune_rl.compiled import compile_function

_ARRIVED_M = 0.3


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
def rollout_cost(
    controls: Any, twist: Any, goal: Any, points: Any, vehicle: Any, weights: Any, margin_m: float, model: Any
) -> float:
    """Cost of `controls` (H, 2: speed, yaw rate) from the origin, by a unicycle model with lags.

    `model` is (time of a step [s], time constant of both responses [s]); `twist` (2,) is the present speed
    and yaw rate; `goal` (2,) and `points` (P, 2) [m] are in the vehicle's frame.
    """
    step_s, lag_s = model
    share = min(1.0, step_s / lag_s)
    x, y, yaw = 0.0, 0.0, 0.0
    speed, turn = twist[0], twist[1]
    cost = 0.0
    for step in range(len(controls)):
        wanted_speed, wanted_turn = _clip_control(controls[step], vehicle)
        speed += share * (wanted_speed - speed)
        turn += share * (wanted_turn - turn)
        yaw += 0.5 * turn * step_s
        x += speed * step_s * np.cos(yaw)
        y += speed * step_s * np.sin(yaw)
        yaw += 0.5 * turn * step_s
        apart = _distance_to_points(x, y, yaw, points, vehicle, margin_m)
        if apart < margin_m:
            cost += weights[3] * step_s * (1.0 - apart / margin_m) ** 2
            if apart <= 0.0:
                cost += weights[2] * step_s
        left = np.hypot(goal[0] - x, goal[1] - y)
        if left < _ARRIVED_M:
            return cost
        cost += step_s * weights[1] * left
        cost += weights[4] * step_s * max(0.0, -speed) + weights[5] * step_s * turn * turn
    result: float = cost + weights[0] * np.hypot(goal[0] - x, goal[1] - y)
    return result


@compile_function
def update_controls(
    nominal: Any,
    noise: Any,
    twists: Any,
    goals: Any,
    points: Any,
    counts: Any,
    vehicle: Any,
    weights: Any,
    margin_m: float,
    model: Any,
    temperature: float,
) -> None:
    """One iteration of path integral control for each row, which changes `nominal` (N, H, 2).

    `noise` (N, S, H, 2) is added to the nominal controls: S samples for each row. `points` (N, P, 2) [m] are
    obstacles in the vehicles' frames, of which row n has `counts[n]`. Samples are weighted by their costs as
    in Williams et al. (2017), without the term of the control's own cost.
    """
    samples, horizon = noise.shape[1], noise.shape[2]
    costs = np.empty(samples)
    controls = np.empty((horizon, 2))
    for row in range(len(nominal)):
        own = points[row, : counts[row]]
        for sample in range(samples):
            for step in range(horizon):
                controls[step, 0] = nominal[row, step, 0] + noise[row, sample, step, 0]
                controls[step, 1] = nominal[row, step, 1] + noise[row, sample, step, 1]
            costs[sample] = rollout_cost(
                controls, twists[row], goals[row], own, vehicle, weights, margin_m, model
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
