"""Motion models of kinematic bodies: where N of them get in a control step, if nothing is in their way.

Actions are a speed [m/s] and a heading relative to the present one [rad]; flying bodies may have a rate of
climb [m/s] as well. Speeds are clipped to those of the body. Of the heading a body turns as much as it can in
a step: all of it where nothing limits its turning, whatever the heading is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle

MotionModelName = Literal["unicycle", "bicycle", "holonomic", "flying"]


class Step(NamedTuple):
    """A control step of N bodies: `xy` (N, 2) [m], `yaw` (N,) [rad] and `velocity` (N, 2) [m/s] at its end.

    The frame of `velocity` is the motion model's: unicycles and bicycles have (forward speed, 0) in the body
    frame, all other models (x, y) in the world frame.
    """

    xy: Array
    yaw: Array
    velocity: Array


@dataclass(frozen=True)
class MotionLimits:
    """What a body can do, and how it moves.

    `model` is one of:

    - `unicycle`: it turns at up to `max_turn_radps`, on the spot too, and goes where it faces.
    - `bicycle`: its rear axle, `rear_m` behind the origin, follows curves of at least `turning_radius_m`.
    - `holonomic`: it goes in any direction, and turns towards it at up to `max_turn_radps`.
    - `flying`: as `holonomic`, and climbs or sinks at up to `max_climb_mps`.

    A speed of None is not limited. `max_reverse_mps` is 0 for bodies that never go backwards.
    """

    model: MotionModelName
    max_speed_mps: float
    max_turn_radps: float | None = None
    turning_radius_m: float = 0.0
    rear_m: float = 0.0
    max_reverse_mps: float = 0.0
    acceleration_mps2: float | None = None
    braking_mps2: float | None = None
    max_climb_mps: float = 0.0


class TurningCircle(NamedTuple):
    """The tightest curve of a body: its rear axle, `rear_m` behind the origin, has `radius_m` [m] or more."""

    radius_m: float
    rear_m: float


# Where bodies at poses (N, 6: x, y, z [m], yaw, roll, pitch [rad]) with velocities (N, 2) get in a step [s],
# by actions (N, 2 or 3): speed [m/s], heading relative to the present one [rad], and climb [m/s].
MotionModel = Callable[[MotionLimits, Array, Array, Array, float], Step]


class MotionSettings(Settings):
    """Settings of a motion model; `name` selects the settings class when a file is read."""

    name: str


class MotionModelRegistry(Registry[Step]):
    """Motion models: functions `f(limits, poses, velocity, actions, step_s, *, SETTINGS) -> Step`."""

    def bind(self, conf: MotionSettings) -> MotionModel:
        """The motion model with its settings."""
        part = self.part_of(conf)
        return partial(part.target, **part.signature.arguments(conf))

    def parse_motion(self, value: Any) -> Any:
        """A model's settings from a mapping, or from its name alone; for a `BeforeValidator`."""
        return self.parse_settings({self.tag: value} if isinstance(value, str) else value)


MOTION_MODELS = MotionModelRegistry(
    "motion model",
    "dune_rl.bodies.motion:MOTION_MODELS",
    own={
        "unicycle": "dune_rl.bodies.motion:unicycle",
        "bicycle": "dune_rl.bodies.motion:bicycle",
        "holonomic": "dune_rl.bodies.motion:holonomic",
        "flying": "dune_rl.bodies.motion:holonomic",
    },
    base=MotionSettings,
    product=Step,
    form="a function of (limits, poses, velocity, actions, step_s) that returns a Step",
    function_leading=("limits", "poses", "velocity", "actions", "step_s"),
)

Motion = Annotated[
    SerializeAsAny[MotionSettings],
    BeforeValidator(MOTION_MODELS.parse_motion),
    Field(description="motion model in place of the body's own; null: its own"),
]


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
