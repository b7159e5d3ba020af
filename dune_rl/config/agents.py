"""Agent groups as they are configured, and what the shorthands `robot`, `robots` and `actors` stand for."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, SerializeAsAny, model_validator

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.bodies.person import PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings
from dune_rl.metrics.episode import MetricsConf
from dune_rl.robots.registry import ROBOTS
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import SensorsConf
from dune_rl.settings import Settings
from dune_rl.suggestions import closest, one_of
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.task import TaskConf, walking_task

EXTERNAL, PATH, TRAJECTORY = "external", "path", "trajectory"
PERSON = "person"
_MOST_AGENTS = 1000
# Agents are called GROUP_0, GROUP_1, ...; TorchRL has keys of its own beside the groups'.
_GROUP_NAME = re.compile(r"[A-Za-z]\w*")
_TAKEN_NAMES = ("action", "done", "metrics", "next", "observation", "reward", "terminated", "truncated")


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


class FrozenPolicyConf(Settings):
    """A controller that is a trained policy: a run's folder, or a file of weights."""

    checkpoint: str = Field(min_length=1)


class TrajectoryFilesConf(Settings):
    """A controller that is a trajectory for each agent, from files (.sdf, .csv, .json) in their order."""

    trajectory: Annotated[tuple[str, ...], BeforeValidator(_as_list)] = Field(min_length=1)


Controller = (
    Literal["external", "path", "trajectory"] | FrozenPolicyConf | TrajectoryFilesConf | BehaviourSettings
)


def _parse_body(value: Any) -> Any:
    if isinstance(value, str):
        value = {"name": value}
    if isinstance(value, Mapping) and isinstance(name := value.get("name"), str):
        bodies = BODIES.names()
        if name in bodies:
            return BODIES.parse_settings(value)
        known = [*bodies, *ROBOTS.names()]
        if name not in known:
            near = closest(name, known)
            remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
            raise ValueError(f"there is no body {name!r}; {remedy}")
    return ROBOTS.parse_settings(value)


def plain_controller(value: Any) -> Any:
    """A controller as it is written; `{name: path}` and others without settings of their own as text."""
    if isinstance(value, Mapping) and value.keys() == {"name"} and isinstance(value["name"], str):
        return value["name"] if value["name"] in (EXTERNAL, PATH, TRAJECTORY) else value
    return value


def _parse_controller(value: Any) -> Any:
    value = plain_controller(value)
    if isinstance(value, Settings) or (isinstance(value, str) and value in (EXTERNAL, PATH, TRAJECTORY)):
        return value
    if isinstance(value, Mapping) and "checkpoint" in value:
        return FrozenPolicyConf.model_validate(value)
    if isinstance(value, Mapping) and TRAJECTORY in value:
        return TrajectoryFilesConf.model_validate(value)
    name = value.get("name") if isinstance(value, Mapping) else value
    if name in (EXTERNAL, PATH, TRAJECTORY):
        raise ValueError(f"{name} has no settings here: write controller: {name}")
    if name is None:
        raise ValueError(
            "a controller's mapping has a name, {name: BEHAVIOUR, ...}, a checkpoint, {checkpoint: PATH}, or "
            "a trajectory, {trajectory: FILE}"
        )
    known = [EXTERNAL, PATH, TRAJECTORY, *BEHAVIOURS.names()]
    if not isinstance(name, str) or name not in known:
        near = closest(str(name), known)
        remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}, or {{checkpoint: PATH}}"
        raise ValueError(f"there is no controller {name!r}; {remedy}")
    if isinstance(value, str) and BEHAVIOURS.is_loaded(name):
        settings = BEHAVIOURS.settings_class(name)
        assert settings is not None, name
        fields = settings.model_fields.items()
        needed = [key for key, field in fields if field.is_required() and key != BEHAVIOURS.tag]
        if needed:
            raise ValueError(
                f"{name} needs {' and '.join(needed)}; write controller: {{name: {name}, {needed[0]}: ...}}"
            )
    return BEHAVIOURS.parse_settings({"name": value} if isinstance(value, str) else value)


class AgentGroupConf(Settings):
    """A group of `count` equal agents.

    `body` is a robot, or a person, vehicle, animal or drone (`BODIES`).
    `controller` is `external` (a user or a learner gives its actions), `path`
    (there and back along a path), `trajectory` (the one of the world's file),
    `{trajectory: FILE}` (those of another file), a behaviour, or a checkpoint of
    a trained policy. `path` has the paths on which persons start, and between
    whose ends they go; other bodies have none unless it is given, and start and
    go in the region of their task. With `presence` the agents come and go.

    Where `sensors`, `task` or `metrics` are None, they follow from the rest:
    see `resolve_groups`.
    """

    body: Annotated[SerializeAsAny[RobotSettings | BodySettings], BeforeValidator(_parse_body)]
    count: int = Field(1, ge=1, le=_MOST_AGENTS, description="number of agents")
    controller: Annotated[SerializeAsAny[Controller], BeforeValidator(_parse_controller)] = "external"
    path: PathConf | None = Field(
        None, description="where persons start, and between which ends they go; null: the defaults below"
    )
    presence: PresenceConf | None = Field(
        None, description="when the agents come and go; null: they are there all the time"
    )
    sensors: SensorsConf | None = None
    task: TaskConf | None = None
    metrics: MetricsConf | None = None

    @model_validator(mode="after")
    def _body_can_do_it(self) -> Self:
        fault = why_not(self.body, self.controller, has_path=self.path is not None)
        if fault:
            raise ValueError(fault)
        if self.presence is not None and not isinstance(self.body, BodySettings):
            raise ValueError(
                f"presence is for people, vehicles and animals, and a {self.body.name} stays: leave it out"
            )
        if self.presence is not None and follows_trajectories(self.controller):
            raise ValueError("presence: trajectories have times of their own; leave presence out")
        return self


def _checked_names(groups: dict[str, AgentGroupConf]) -> dict[str, AgentGroupConf]:
    for name in groups:
        if not _GROUP_NAME.fullmatch(name):
            raise ValueError(f"a group cannot be called {name!r}: take letters, digits and _, a letter first")
        if name in _TAKEN_NAMES:
            raise ValueError(f"a group cannot be called {name!r}, which is a key of TorchRL's")
    return groups


AgentGroups = Annotated[dict[str, AgentGroupConf], AfterValidator(_checked_names)]


@dataclass(frozen=True)
class ResolvedGroup:
    """An agent group with all that it is made of.

    A group without `task` has no goal of its own, earns nothing and never ends an episode; one without
    `sensors` observes nothing. `path` is set for persons, and only for them.
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


def is_on_path(body: RobotSettings | BodySettings, controller: Controller, *, has_path: bool) -> bool:
    """Whether agents start on paths or trajectories: persons do, and other bodies that are given one."""
    if not isinstance(body, BodySettings):
        return False
    return isinstance(body, PersonConf) or controller == PATH or follows_trajectories(controller) or has_path


def why_not(body: RobotSettings | BodySettings, controller: Controller, *, has_path: bool) -> str:
    """Why a body cannot do what a controller has it do, and what to write instead; empty where it can."""
    if not isinstance(body, BodySettings) and (
        controller == PATH or follows_trajectories(controller) or has_path
    ):
        return (
            f"paths are walked by persons, and the body is {body.name}: choose another controller, "
            "and leave path out"
        )
    motion = motion_model(body)
    if controller == PATH and motion in ("bicycle", "flying"):
        cannot = "turn round on the spot at its ends" if motion == "bicycle" else "walk it"
        return f"controller path: a {body.name} cannot {cannot}; write controller: go_to_goal"
    part = BEHAVIOURS.find(controller.name) if isinstance(controller, BehaviourSettings) else None
    fit = None if part is None else getattr(part.target, "motion_models", None)
    if fit is None or motion in fit:
        return ""
    assert isinstance(controller, BehaviourSettings)
    able = [
        name
        for name in BODIES.own
        if (known := BODIES.settings_class(name)) is not None and known.motion_model in fit
    ]
    return (
        f"controller {controller.name} is for bodies that move as {one_of(fit)}, and {body.name} "
        f"is {motion}: choose another controller, or the body {one_of(able)}"
    )


def motion_model(body: RobotSettings | BodySettings) -> str:
    """How a body moves: unicycle, bicycle, holonomic or flying."""
    if isinstance(body, BodySettings):
        return body.motion_model
    steers = getattr(getattr(body, "drive", None), "kind", None) == "ackermann"
    return "bicycle" if steers else "unicycle"


def follows_trajectories(controller: Controller) -> bool:
    """Whether a controller moves its agents on trajectories, of the world's file or of others."""
    return controller == TRAJECTORY or isinstance(controller, TrajectoryFilesConf)


def reads_sensors(controller: Controller) -> bool:
    """Whether a controller needs its group's observation."""
    if isinstance(controller, FrozenPolicyConf):
        return True
    part = BEHAVIOURS.find(controller.name) if isinstance(controller, BehaviourSettings) else None
    return part is not None and getattr(part.target, "reads_sensors", False)


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


def robot_groups(robots: Iterable[RobotSettings], taken: Iterable[str]) -> dict[str, AgentGroupConf]:
    """A group for each kind of equal robots, in the order of the first of each.

    Rover Zero's is called `rover`, another has its robot's name; a further one of a name gets `_b`, `_c` and
    so on, and so does one whose name is `taken`.
    """
    counts: dict[RobotSettings, int] = {}
    for robot in robots:
        counts[robot] = counts.get(robot, 0) + 1
    groups: dict[str, AgentGroupConf] = {}
    for robot, count in counts.items():
        label = "rover" if robot.name == "rover_zero" else re.sub(r"\W", "_", robot.name)
        name = free_name(label, {*taken, *groups})
        groups[name] = AgentGroupConf(body=robot, count=count)
    return groups


def free_name(name: str, taken: Iterable[str]) -> str:
    """The name, with `_b`, `_c`, ... behind it where it is taken."""
    letters = "bcdefghijklmnopqrstuvwxyz"
    known = set(taken)
    return next(each for each in (name, *(f"{name}_{letter}" for letter in letters)) if each not in known)
