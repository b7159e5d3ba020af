"""Agent groups with all that they are made of: their own settings, and what follows from them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.bodies.settings import BodySettings
from dune_rl.config.agents import AgentGroupConf, is_on_path
from dune_rl.config.controller_settings import EXTERNAL, Controller, reads_sensors
from dune_rl.metrics.episode import MetricsConf
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import SensorsConf
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.task import TaskConf, walking_task


@dataclass(frozen=True)
class ResolvedGroup:
    """An agent group with all that it is made of.

    A group without `task` has no goal of its own, earns nothing and never ends an episode; one without
    `sensors` observes nothing. `path` is set for those that start on paths: persons, and others if they are
    given one.
    """

    name: str
    body: RobotSettings | BodySettings
    count: int
    controller: Controller
    path: PathConf | None
    sensors: SensorsConf | None
    task: TaskConf | None
    metrics: MetricsConf | None
    presence: PresenceConf | None = None

    @property
    def is_external(self) -> bool:
        """Whether its actions come from outside."""
        return self.controller == EXTERNAL

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of its agents."""
        return tuple(f"{self.name}_{number}" for number in range(self.count))


@dataclass(frozen=True)
class GroupDefaults:
    """What the groups of robots have unless they say otherwise: the environment's own sections."""

    sensors: SensorsConf
    task: TaskConf
    metrics: MetricsConf


def resolve_groups(
    groups: Mapping[str, AgentGroupConf], defaults: GroupDefaults
) -> tuple[ResolvedGroup, ...]:
    """The groups in their order, with the sensors, task and metrics of those that do not say.

    | body   | controller  | sensors       | task          | metrics       |
    |--------|-------------|---------------|---------------|---------------|
    | robot  | external    | environment's | environment's | environment's |
    | robot  | checkpoint  | environment's | roaming       | none          |
    | robot  | a behaviour | none          | roaming       | none          |
    | person | external    | walker's      | walking       | none          |
    | person | checkpoint  | walker's      | to and fro    | none          |
    | person | another     | none          | none          | none          |
    | other  | external    | walker's      | environment's | environment's |
    | other  | checkpoint  | walker's      | roaming       | none          |
    | other  | another     | none          | roaming       | none          |

    A vehicle, an animal or a drone is "other", unless it is on a path: then it is as a person. Roaming agents
    start and go where the environment's task has it, and get another goal at each.
    """
    return tuple(_resolved(name, group, defaults) for name, group in groups.items())


def _resolved(name: str, group: AgentGroupConf, defaults: GroupDefaults) -> ResolvedGroup:
    is_body = isinstance(group.body, BodySettings)
    on_path = is_on_path(group.body, group.controller, has_path=group.path is not None)
    is_external = group.controller == EXTERNAL
    observes = is_external or reads_sensors(group.controller)
    sensors: SensorsConf | None = None
    task: TaskConf | None = None
    metrics: MetricsConf | None = None
    if observes:
        sensors = walker_sensors() if is_body else defaults.sensors
    if is_external:
        task = walking_task() if on_path else defaults.task
        # These bodies have no motors.
        metrics = defaults.metrics.model_copy(update={"energy": False}) if is_body else defaults.metrics
    elif not on_path:
        task = roaming_task(defaults.task)
    elif observes:
        task = roaming_task(walking_task())
    return ResolvedGroup(
        name,
        group.body,
        group.count,
        group.controller,
        (group.path or PathConf()) if on_path else None,
        group.sensors or sensors,
        group.task or task,
        group.metrics or metrics,
        group.presence,
    )


def walker_sensors() -> SensorsConf:
    """What persons observe: the end of their path, the nearest other agent, and their own velocity."""
    return SensorsConf.model_validate(
        {
            "enabled": ["goal", "nearest_agent", "velocity"],
            "named": {"velocity": {"sensor": "planar_velocity"}},
        }
    )


def roaming_task(task: TaskConf) -> TaskConf:
    """A task of the same starts and goals that earns nothing and never ends: goal follows goal."""
    return TaskConf.model_validate(roaming_settings(task.model_dump()))


def roaming_settings(task: Mapping[str, Any]) -> dict[str, Any]:
    """`roaming_task` of settings as plain data, which need not be valid."""
    endings = task.get("terminations")
    reached = endings.get("goal_reached") if isinstance(endings, Mapping) else None
    renewed = {"goal_reached": {**reached, "renew": True}} if isinstance(reached, Mapping) else {}
    return {**task, "rewards": {}, "terminations": renewed}
