"""Motion models of kinematic bodies: where N of them get in a control step, if nothing is in their way.

Actions are a speed [m/s] and a heading relative to the present one [rad]; flying bodies may have a rate of
climb [m/s] as well. Speeds are clipped to those of the body. Of the heading a body turns as much as it can in
a step: all of it where nothing limits its turning, whatever the heading is.
"""

import numpy as np

from dune_rl.bodies.motion import MotionLimits, Step
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle


def stopping_distance(limits: MotionLimits, speed: Array, step_s: float) -> Array:
    """Way [m], (N,), in which bodies of `speed` (N,) stop from the next step on."""
    if limits.braking_mps2 is None:
        return np.zeros_like(speed)
    way: Array = speed**2 / (2.0 * limits.braking_mps2) + np.abs(speed) * step_s
    return way


def unicycle(limits: MotionLimits, poses: Array, velocity: Array, actions: Array, step_s: float) -> Step:
    """It turns, and goes where it faces then."""
    yaw = wrap_angle(poses[:, 3] + _turn(limits, actions, step_s))
    speed = np.clip(actions[:, 0], 0.0, limits.max_speed_mps)
    speed = _accelerated(limits, velocity[:, 0], speed, step_s)
    return Step(_ahead(poses, yaw, speed * step_s), yaw, np.stack([speed, np.zeros_like(speed)], axis=-1))


def bicycle(limits: MotionLimits, poses: Array, velocity: Array, actions: Array, step_s: float) -> Step:
    """Kinematic bicycle: the rear axle's middle moves along the body, on curves as tight as its steering has.

    Kong et al. 2015, Kinematic and dynamic vehicle models for autonomous driving control design, without
    slip; the curvature is set at once.
    """
    wanted = np.clip(actions[:, 0], -limits.max_reverse_mps, limits.max_speed_mps)
    speed = _accelerated(limits, velocity[:, 0], wanted, step_s)
    way = speed * step_s
    most = np.abs(way) / limits.turning_radius_m
    # Backwards the front wheels are turned the other way, so that the front swings to the same side.
    turn = np.clip(wrap_angle(actions[:, 1]), -most, most)
    yaw = wrap_angle(poses[:, 3] + turn)
    rear = _ahead(poses, poses[:, 3], np.full_like(way, -limits.rear_m))
    middle = poses[:, 3] + turn / 2.0
    # A chord is shorter than its arc.
    chord = way * np.sinc(turn / (2.0 * np.pi))
    rear = rear + chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
    xy = rear + limits.rear_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return Step(xy, yaw, np.stack([speed, np.zeros_like(speed)], axis=-1))


def holonomic(limits: MotionLimits, poses: Array, velocity: Array, actions: Array, step_s: float) -> Step:
    """It goes in the direction of its heading at once, and turns towards it."""
    speed = np.clip(actions[:, 0], 0.0, limits.max_speed_mps)
    way = poses[:, 3] + actions[:, 1]
    change = speed[:, None] * np.stack([np.cos(way), np.sin(way)], axis=-1) - velocity
    if limits.acceleration_mps2 is not None:
        length = np.maximum(np.hypot(change[:, 0], change[:, 1]), 1e-12)
        change = change * np.minimum(limits.acceleration_mps2 * step_s / length, 1.0)[:, None]
    reached = velocity + change
    yaw = wrap_angle(poses[:, 3] + _turn(limits, actions, step_s))
    return Step(poses[:, :2] + reached * step_s, yaw, reached)


def _turn(limits: MotionLimits, actions: Array, step_s: float) -> Array:
    """Angles (N,) [rad] by which bodies turn: the relative headings, as far as `max_turn_radps` lets them."""
    heading = np.where(np.abs(actions[:, 1]) > np.pi, wrap_angle(actions[:, 1]), actions[:, 1])
    if limits.max_turn_radps is None:
        return heading
    most = limits.max_turn_radps * step_s
    turn: Array = np.clip(heading, -most, most)
    return turn


def _accelerated(limits: MotionLimits, speed: Array, wanted: Array, step_s: float) -> Array:
    """The speeds (N,) that bodies reach on the way from `speed` to `wanted`, forwards or backwards."""
    if limits.acceleration_mps2 is None:
        return wanted
    gain = limits.acceleration_mps2 * step_s
    loss = gain if limits.braking_mps2 is None else limits.braking_mps2 * step_s
    # A step may end in standing still, but does not go on from braking to speeding up the other way.
    forwards = speed >= 0.0
    reached = np.where(
        forwards,
        np.clip(wanted, np.minimum(speed, np.maximum(speed - loss, 0.0)), speed + gain),
        np.clip(wanted, speed - gain, np.maximum(speed, np.minimum(speed + loss, 0.0))),
    )
    from_rest: Array = np.where(speed == 0.0, np.clip(wanted, -gain, gain), reached)
    return from_rest


def _ahead(poses: Array, yaw: Array, distance: Array) -> Array:
    found: Array = poses[:, :2] + distance[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return found
