"""What a program needs beside a trained policy's network: its inputs, its action, its rate, and its robot."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field

from dune_rl.config.build import build_robot
from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.core.settings import Settings
from dune_rl.env.articulated import carrier_of, vehicle_of
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import Sensors, describe_reading
from dune_rl.state.unicycle import Unicycle

_SPEED_AND_HEADING = ("speed_mps", "relative_heading_rad")


def _is_shape(value: tuple[int, ...]) -> tuple[int, ...]:
    if not value or min(value) < 1 or math.prod(value) > 10_000_000:
        raise ValueError(f"must be the shape of a reading (got {list(value)})")
    return value


class InputConf(Settings):
    """A part of the observation; `meaning` has its units, and is empty in files of before."""

    shape: Annotated[tuple[int, ...], AfterValidator(_is_shape)]
    dtype: Literal["float32", "uint8"]
    meaning: str = ""


class ActionConf(Settings):
    """A component of the action, and its bounds."""

    name: str
    low: float
    high: float


class PolicyInterface(Settings):
    """The inputs and the action of the policy of `group`, which decides every `decision_s`.

    `control_step_s` is the period of its sensors, and `sensors` has their settings with the robot's mounts.
    `vehicle` says how its robot follows a speed and a heading, `goal_m` how near the goal was reached; both
    are None where there is none.
    """

    group: str
    observation: dict[str, InputConf]
    action: tuple[ActionConf, ...]
    decision_s: float = Field(gt=0.0)
    control_step_s: float = Field(gt=0.0)
    sensors: Sensors
    vehicle: Unicycle | None
    goal_m: float | None = Field(gt=0.0)

    @classmethod
    def of_run(cls, spec: PolicySpec, group: str, config: Mapping[str, Any]) -> Self:
        """That of a policy with `spec` in a run of the settings `config`."""
        conf = compose(ViewConf, [], (), config)
        groups = {each.name: each for each in conf.external_groups}
        own = groups.get(group, conf.external_groups[0])
        sensors = {name: each for name, each in (own.sensors or {}).items() if each.observed}
        vehicle = None
        names = [f"joint_{number}" for number in range(spec.action_size)]
        if spec.action_size == len(_SPEED_AND_HEADING):
            names = list(_SPEED_AND_HEADING)
        if isinstance(own.body, RobotSettings):
            robot = build_robot(own.body, 1)
            sensors = {name: each.mounted_on(carrier_of(robot)) for name, each in sensors.items()}
            vehicle = vehicle_of(robot) if names[0] == _SPEED_AND_HEADING[0] else None
        parts = {key: spec.part(key) for key in spec.keys}
        return cls(
            group=group,
            observation={
                key: InputConf(
                    shape=part.shape,
                    dtype="uint8" if part.uint8 else "float32",
                    meaning=describe_reading(sensors, key),
                )
                for key, part in parts.items()
            },
            action=tuple(
                ActionConf(name=name, low=low, high=high)
                for name, low, high in zip(names, spec.low, spec.high, strict=True)
            ),
            decision_s=conf.physics.control_step_s * conf.physics.action_repeat,
            control_step_s=conf.physics.control_step_s,
            sensors=sensors,
            vehicle=vehicle,
            goal_m=None if own.task is None else own.task.goal_reached_m,
        )
