"""Motion models of kinematic bodies, their registry, and what bounds a body's motion."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array

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
        "unicycle": "dune_rl.bodies.motion_models:unicycle",
        "bicycle": "dune_rl.bodies.motion_models:bicycle",
        "holonomic": "dune_rl.bodies.motion_models:holonomic",
        "flying": "dune_rl.bodies.motion_models:holonomic",
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
