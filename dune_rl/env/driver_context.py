"""The vehicle model of an agent group, for the behaviours that drive by one."""

import numpy as np

from dune_rl.behaviours.drivers.context import ContextBehaviour, DriverContext, Unicycle
from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.kinematic import KinematicBody

_SPEED_AND_HEADING = 2
# Of robots that do not say.
_YAW_RATE_RADPS = 1.0
_HEADING_GAIN_PER_S = 2.0


def bind_to_group(behaviour: object, name: str, group: AgentGroup) -> None:
    """Bind a behaviour to `group` if it wants that; raises ConfigError if it cannot drive there."""
    if not isinstance(behaviour, ContextBehaviour):
        return
    if group.action_size != _SPEED_AND_HEADING:
        raise ConfigError(
            f"{name} cannot act for the group {group.name}: it outputs a speed and a heading, and the action "
            f"has {group.action_size} components; choose another robot.action"
        )
    lidar = None if group.suite is None else group.suite.conf.lidar
    behaviour.bind(DriverContext(group.name, _unicycle(group), lidar, group.observe))


def _unicycle(group: AgentGroup) -> Unicycle:
    low, high = group.action_bounds
    speeds = float(low[0]), float(high[0])
    body = group.body
    if isinstance(body, KinematicBody):
        # It turns to the commanded heading within the step, as far as its limits let it.
        length, width, _ = body.conf.size_m
        radius = body.description.turning_radius_m
        limit = body.limits.max_turn_radps
        fastest = speeds[1] / radius if radius else np.pi / body.step_s if limit is None else limit
        reach = body.conf.keep_out_radius_m
        return Unicycle(*speeds, fastest, 1.0 / body.step_s, length, width, reach, radius)
    assert isinstance(body, ArticulatedBody)
    robot = body.robot
    steering = None if robot.wheels is None else robot.wheels.steering
    return Unicycle(
        *speeds,
        getattr(robot, "max_yaw_rate_radps", _YAW_RATE_RADPS),
        getattr(robot, "heading_gain_per_s", _HEADING_GAIN_PER_S),
        robot.length_m,
        robot.width_m,
        robot.footprint_radius_m,
        0.0 if steering is None else 1.0 / min(steering.max_curvatures()),
    )
