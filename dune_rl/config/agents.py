"""Agent groups as they are configured, with the presets of what they observe, do and are measured by."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, SerializeAsAny, model_validator

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.bodies.person import PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings
from dune_rl.config.controllers import (
    EXTERNAL,
    PATH,
    Controller,
    follows_trajectories,
    parse_controller,
    reads_sensors,
)
from dune_rl.core.errors import DuneError
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import advise, one_of
from dune_rl.metrics.episode import MetricsConf
from dune_rl.robots.registry import ROBOTS
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import Sensors, parse_sensors
from dune_rl.sensors.settings import SensorSettings
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.task import TaskConf, walking_task

PERSON = "person"
SHARED, NONE = "shared", "none"
# What a section of a group may be called in place of settings of its own: `presets_of` says what each is.
PRESETS: Mapping[str, tuple[str, ...]] = {
    "sensors": (SHARED, "walker", NONE),
    "task": (SHARED, "roaming", "walking", "to_and_fro", NONE),
    "metrics": (SHARED, NONE),
}
# The settings of each section, of sensors those of each entry.
SECTIONS: Mapping[str, type[Settings]] = {"sensors": SensorSettings, "task": TaskConf, "metrics": MetricsConf}
_MOST_AGENTS = 1000
# Agents are called GROUP_0, GROUP_1, ...; TorchRL has keys of its own beside the groups'.
_GROUP_NAME = re.compile(r"[A-Za-z]\w*")
_TAKEN_NAMES = ("action", "done", "metrics", "next", "observation", "reward", "terminated", "truncated")

Body = RobotSettings | BodySettings


def _parse_body(value: Any) -> Any:
    if isinstance(value, str):
        value = {"name": value}
    if isinstance(value, Mapping) and isinstance(name := value.get("name"), str):
        bodies = BODIES.names()
        if name in bodies:
            return BODIES.parse_settings(value)
        known = [*bodies, *ROBOTS.names()]
        if name not in known:
            remedy = advise(name, known)
            raise ValueError(f"there is no body {name!r}; {remedy}")
    return ROBOTS.parse_settings(value)


def _parse_section(section: str) -> BeforeValidator:
    """Leaves the name of a preset as it is, and parses anything else as settings."""

    def parse(value: Any) -> Any:
        if value is None or value in PRESETS[section]:
            return value
        return parse_section(section, value)

    return BeforeValidator(parse)


def parse_section(section: str, value: Any) -> Any:
    """The settings of a section from plain data; raises pydantic's ValidationError."""
    return parse_sensors(value) if section == "sensors" else SECTIONS[section].model_validate(value)


def is_complete(section: str, settings: Mapping[str, Any]) -> bool:
    """Whether plain settings of a section are all that there are, as in a saved run, and so no changes."""
    parts = settings.values() if section == "sensors" else (settings,)
    return bool(settings) and all(
        isinstance(part, Mapping) and SECTIONS[section].model_fields.keys() <= part.keys() for part in parts
    )


class AgentGroupConf(Settings):
    """A group of `count` equal agents.

    `body` is a robot, or a person, vehicle, animal or drone (`BODIES`). `controller` is `external` (a user or
    a learner gives its actions), `path` (moved along a path, `path.mode`), `trajectory` (the one of the
    world's file), `{trajectory: FILE}` (those of another file), a behaviour, or a checkpoint of a trained
    policy. `path` has the paths on which persons start, and between whose ends they go; other bodies have
    none unless it is given, and start and go in the region of their task. With `presence` the agents come and
    go.

    `sensors`, `task` and `metrics` are settings, or the name of a preset (`presets_of`). Where one is left
    out, the preset of the body and the controller is filled in, and so is `path` for agents on paths.
    """

    body: Annotated[SerializeAsAny[Body], BeforeValidator(_parse_body)]
    count: int = Field(1, ge=1, le=_MOST_AGENTS, description="number of agents")
    controller: Annotated[SerializeAsAny[Controller], BeforeValidator(parse_controller)] = "external"
    path: PathConf | None = Field(
        None, description="where persons start, and between which ends they go; null: the defaults below"
    )
    presence: PresenceConf | None = Field(
        None, description="when the agents come and go; null: they are there all the time"
    )
    sensors: Annotated[Sensors | Literal["shared", "walker", "none"] | None, _parse_section("sensors")] = None
    task: Annotated[
        TaskConf | Literal["shared", "roaming", "walking", "to_and_fro", "none"] | None,
        _parse_section("task"),
    ] = None
    metrics: Annotated[MetricsConf | Literal["shared", "none"] | None, _parse_section("metrics")] = None

    @property
    def is_robot(self) -> bool:
        return isinstance(self.body, RobotSettings)

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
        is_moved = self.controller == PATH or follows_trajectories(self.controller)
        if is_moved and self.task not in (None, NONE):
            raise ValueError(
                "task: agents that are moved along a path or a trajectory earn nothing and end no episode: "
                "leave task out (null), or write controller: external"
            )
        return self

    @model_validator(mode="after")
    def _nothing_is_left_open(self) -> Self:
        on_path = is_on_path(self.body, self.controller, has_path=self.path is not None)
        filled: dict[str, Any] = {"path": PathConf()} if on_path else {}
        for name, value in {**filled, **presets_of(self.body, self.controller, on_path=on_path)}.items():
            if getattr(self, name) is None:
                # The settings are frozen for everybody else.
                object.__setattr__(self, name, value)
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
    """An agent group with settings in the place of its presets.

    A group without `task` has no goal of its own, earns nothing and never ends an episode; one without
    `sensors` observes nothing. `path` is set for agents that start on paths: persons, and others if they are
    given one.
    """

    name: str
    body: Body
    count: int
    controller: Controller
    path: PathConf | None
    sensors: Sensors | None
    task: TaskConf | None
    metrics: MetricsConf | None
    presence: PresenceConf | None = None

    @property
    def is_external(self) -> bool:
        return self.controller == EXTERNAL

    @property
    def agents(self) -> tuple[str, ...]:
        return tuple(f"{self.name}_{number}" for number in range(self.count))


def presets_of(
    body: Body, controller: Controller, *, on_path: bool, with_all: bool = False
) -> dict[str, str]:
    """The presets of a group's sensors, task and metrics.

    - `shared`: the section of the environment
    - `walker`: goal, nearest other agent, own velocity (`sensors=walker`)
    - `roaming`: starts and goals of the shared task; goal follows goal, nothing is earned
    - `walking`: to the ends of the path, clear of others (`task=walking`); `to_and_fro`: the same, nothing
      is earned
    - `none`: nothing is observed, done or measured

    Robots observe by `shared` sensors, other bodies by `walker`. External agents have the shared task, on
    paths `walking`, and the shared metrics. Agents with another controller have no metrics, and sensors only
    if it reads them; they roam, or go to and fro on their path. With `with_all`, no section is `none`.
    """
    is_external = controller == EXTERNAL
    observes = with_all or is_external or reads_sensors(controller)
    task = ("walking" if is_external else "to_and_fro") if on_path else SHARED if is_external else "roaming"
    return {
        "sensors": ("walker" if isinstance(body, BodySettings) else SHARED) if observes else NONE,
        "task": task if observes or not on_path else NONE,
        "metrics": SHARED if is_external or with_all else NONE,
    }


def preset_settings(section: str, preset: str, shared: Any) -> Any:
    """The settings of a preset, given the environment's section `shared`; None for `none`."""
    match section, preset:
        case (_, "none"):
            return None
        case ("sensors", "walker"):
            return walker_sensors()
        case ("task", "walking"):
            return walking_task()
        case ("task", "to_and_fro"):
            return roaming_task(walking_task())
        case ("task", "roaming"):
            return roaming_task(shared)
    return shared


def walker_sensors() -> Sensors:
    """What persons observe: the end of their path, the nearest other agent, and their own velocity."""
    return parse_sensors({"goal": {}, "nearest_agent": {}, "velocity": {"sensor": "planar_velocity"}})


def roaming_task(task: TaskConf) -> TaskConf:
    """A task of the same starts and goals that earns nothing and never ends: goal follows goal."""
    reached = task.terminations.get("goal_reached")
    renewed = {} if reached is None else {"goal_reached": {**reached.model_dump(), "renew": True}}
    return TaskConf.model_validate({**task.model_dump(), "rewards": {}, "terminations": renewed})


def parse_members(group: Mapping[str, Any]) -> tuple[Body, Controller] | None:
    """Body and controller of a group given as plain data; None where one is faulty."""
    with suppress(ValueError, DuneError):
        body = _parse_body(group.get("body"))
        controller = parse_controller(group.get("controller", EXTERNAL))
        if isinstance(body, RobotSettings | BodySettings):
            return body, controller
    return None


def is_on_path(body: Body, controller: Controller, *, has_path: bool) -> bool:
    """Whether agents start on paths or trajectories: persons do, and other bodies that are given one."""
    if not isinstance(body, BodySettings):
        return False
    return isinstance(body, PersonConf) or controller == PATH or follows_trajectories(controller) or has_path


def why_not(body: Body, controller: Controller, *, has_path: bool) -> str:
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


def motion_model(body: Body) -> str:
    """How a body moves: unicycle, bicycle, holonomic or flying."""
    if isinstance(body, BodySettings):
        return body.motion_model
    steers = getattr(getattr(body, "drive", None), "kind", None) == "ackermann"
    return "bicycle" if steers else "unicycle"


def free_name(name: str, taken: Iterable[str]) -> str:
    """The name, with `_b`, `_c`, ... behind it where it is taken."""
    letters = "bcdefghijklmnopqrstuvwxyz"
    known = set(taken)
    return next(each for each in (name, *(f"{name}_{letter}" for letter in letters)) if each not in known)
