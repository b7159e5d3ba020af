"""Agent groups as they are configured, and what the shorthands `robot`, `robots` and `actors` stand for."""

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, SerializeAsAny, model_validator

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.bodies.person import PersonConf
from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings
from dune_rl.config.controller_settings import PATH, Controller, follows_trajectories, parse_controller
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import closest, one_of
from dune_rl.metrics.episode import MetricsConf
from dune_rl.robots.registry import ROBOTS
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import SensorsConf
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.task import TaskConf

PERSON = "person"
_MOST_AGENTS = 1000
# Agents are called GROUP_0, GROUP_1, ...; TorchRL has keys of its own beside the groups'.
_GROUP_NAME = re.compile(r"[A-Za-z]\w*")
_TAKEN_NAMES = ("action", "done", "metrics", "next", "observation", "reward", "terminated", "truncated")


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


class AgentGroupConf(Settings):
    """A group of `count` equal agents.

    `body` is a robot, or a person, vehicle, animal or drone (`BODIES`).
    `controller` is `external` (a user or a learner gives its actions), `path`
    (moved along a path, `path.mode`), `trajectory` (the one of the world's file),
    `{trajectory: FILE}` (those of another file), a behaviour, or a checkpoint of
    a trained policy. `path` has the paths on which persons start, and between
    whose ends they go; other bodies have none unless it is given, and start and
    go in the region of their task. With `presence` the agents come and go.

    Where `sensors`, `task` or `metrics` are None, they follow from the rest:
    see `resolve_groups`.
    """

    body: Annotated[SerializeAsAny[RobotSettings | BodySettings], BeforeValidator(_parse_body)]
    count: int = Field(1, ge=1, le=_MOST_AGENTS, description="number of agents")
    controller: Annotated[SerializeAsAny[Controller], BeforeValidator(parse_controller)] = "external"
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
