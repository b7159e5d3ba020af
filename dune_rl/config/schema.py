"""Every setting there is: one class for training, one for evaluation, both around an environment's."""

from typing import Annotated, Literal, Self, get_args

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationError, model_validator

from dune_rl.config.actors import groups_of_list
from dune_rl.config.agents import AgentGroups, GroupDefaults, ResolvedGroup, resolve_groups, robot_groups
from dune_rl.config.checks import describe_faults
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.learning.sac.settings import SacConf
from dune_rl.learning.settings import LearningConf
from dune_rl.metrics.episode import MetricsConf, metric_names
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.registry import ROBOTS
from dune_rl.robots.rover_zero.robot import RoverZeroConf
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import SensorsConf
from dune_rl.settings import Settings
from dune_rl.suggestions import closest, one_of
from dune_rl.tasks.registry import TERMINATIONS
from dune_rl.tasks.task import DIVERGED, POINT_GOAL_TERMINATIONS, TaskConf
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import WorldSettings

WorldConf = Annotated[SerializeAsAny[WorldSettings], BeforeValidator(WORLDS.parse_settings)]
RobotConf = Annotated[SerializeAsAny[RobotSettings], BeforeValidator(ROBOTS.parse_settings)]
AlgorithmConf = Annotated[SerializeAsAny[LearningConf], BeforeValidator(ALGORITHMS.parse_settings)]


def _one_or_several(names: object) -> object:
    """A list of names, of one name or of none (null)."""
    return () if names is None else (names,) if isinstance(names, str) else names


def _groups(actors: object) -> object:
    return groups_of_list(actors) if isinstance(actors, list | tuple) else actors


class EnvConf(Settings):
    """What an environment is made of; the world has no default.

    `agents` are the agent groups of a scene. Without them `robot`, or several
    `robots`, and `actors`, which are groups beside the robots', stand for them:
    equal robots are one group. `sensors`, `task` and `metrics` are those of the
    groups that have none of their own.
    """

    world: WorldConf
    weather: WeatherConf = WeatherConf()
    agents: Annotated[AgentGroups, Field(min_length=1)] | None = None
    robot: RobotConf = RoverZeroConf()
    robots: Annotated[tuple[RobotConf, ...], Field(min_length=1)] | None = None
    actors: Annotated[AgentGroups, BeforeValidator(_groups)] = Field(default_factory=dict)
    sensors: SensorsConf = SensorsConf()
    physics: PhysicsConf = PhysicsConf()
    task: TaskConf = TaskConf()
    metrics: MetricsConf = MetricsConf()
    randomisation: RandomisationConf = RandomisationConf()

    @property
    def groups(self) -> tuple[ResolvedGroup, ...]:
        """The agent groups of a scene, in order, with all that they are made of."""
        groups = self.agents
        if groups is None:
            robots = (self.robot,) if self.robots is None else self.robots
            groups = {**robot_groups(robots, self.actors), **self.actors}
        return resolve_groups(groups, GroupDefaults(self.sensors, self.task, self.metrics))

    def path_of(self, group: str) -> str:
        """The path of a group's settings, such as `actors.walker`; empty for `robot` and `robots`."""
        if self.agents is not None:
            return f"agents.{group}"
        return f"actors.{group}" if group in self.actors else ""

    @property
    def external_groups(self) -> tuple[ResolvedGroup, ...]:
        """The groups whose actions come from outside: from a user or a learner."""
        return tuple(group for group in self.groups if group.is_external)

    @model_validator(mode="after")
    def _some_group_is_external(self) -> Self:
        if not self.external_groups:
            raise ValueError(
                "no agent group is external; set the controller of one to external, such as "
                f"agents.{self.groups[0].name}.controller=external"
            )
        return self

    @model_validator(mode="after")
    def _somebody_is_there(self) -> Self:
        groups = self.external_groups
        if groups and all(
            group.presence is not None and not group.presence.is_from_the_start for group in groups
        ):
            raise ValueError(
                f"{self.path_of(groups[0].name)}.presence.arrive_s: no external agent is there when an "
                "episode starts; let those of one group come at [0, 0]"
            )
        return self

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        self.randomisation.check(self.world, self.weather)
        return self

    @model_validator(mode="after")
    def _rates_fit(self) -> Self:
        for path, group in self._sensing_groups():
            try:
                group.check_timing(self.physics.control_step_s)
            except ValueError as error:
                raise ValueError(str(error).replace("sensors", path, 1)) from None
        return self

    @model_validator(mode="after")
    def _sensed_groups_exist(self) -> Self:
        known = [group.name for group in self.groups]
        for path, sensors in self._sensing_groups():
            for sensor, sensed in sensors.sensed_groups().items():
                for name in sensed:
                    if name not in known:
                        raise ValueError(
                            f"{path}: {sensor} senses a group {name!r}, which is not there; "
                            f"choose {one_of(known)}"
                        )
        return self

    @model_validator(mode="after")
    def _targets_of_behaviours_exist(self) -> Self:
        known = ["robots", *(group.name for group in self.groups)]
        for group in self.groups:
            target = getattr(group.controller, "target", None)
            if isinstance(target, str) and target not in known:
                raise ValueError(
                    f"{self.path_of(group.name)}.controller.target: there is no group {target!r}; "
                    f"choose {one_of(known)}"
                )
        return self

    @model_validator(mode="after")
    def _measured_terminations_exist(self) -> Self:
        for group in self.groups:
            own = () if group.task is None else group.task.terminations
            # The task may leave out what others have: that is never the end of an episode then.
            known = sorted({*own, *TERMINATIONS.names(), DIVERGED, *POINT_GOAL_TERMINATIONS})
            for name, term in () if group.metrics is None else group.metrics.terms.items():
                ending = getattr(term, "termination", DIVERGED)
                if ending not in known:
                    near = closest(ending, known)
                    remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
                    raise ValueError(
                        f"metrics.terms.{name}.termination: there is no termination {ending!r}; {remedy}"
                    )
        return self

    def _sensing_groups(self) -> list[tuple[str, SensorsConf]]:
        """The different sensors of all groups, and where they are set."""
        found: dict[str, SensorsConf] = {}
        for group in self.groups:
            if group.sensors is self.sensors:
                found["sensors"] = group.sensors
            elif group.sensors is not None:
                found[f"{self.path_of(group.name)}.sensors"] = group.sensors
        return list(found.items())


class OneGroupConf(EnvConf):
    """An environment in which one agent group is external: the one that is trained, evaluated or shown."""

    @model_validator(mode="after")
    def _one_group_is_external(self) -> Self:
        names = [group.name for group in self.external_groups]
        if len(names) > 1:
            raise ValueError(
                f"one agent group is driven here, and {' and '.join(names)} are external; give all but one "
                "another controller (actors=walkers has walkers on paths), or take parallel_env or make"
            )
        return self

    @property
    def driven_group(self) -> ResolvedGroup:
        """The one external group."""
        return self.external_groups[0]


class SingleAgentConf(OneGroupConf):
    """An environment with one external agent, as Gymnasium has it."""

    @model_validator(mode="after")
    def _one_agent_is_external(self) -> Self:
        group = self.driven_group
        if group.count > 1:
            raise ValueError(
                f"Gymnasium has one agent, and {group.name} has {group.count}; take parallel_env or make"
            )
        return self


class Conf(EnvConf):
    """A training run: every external group learns, or acts by a frozen policy."""

    learning: AlgorithmConf = SacConf()
    seed: int = Field(1, ge=0)
    total_frames: int = Field(2_500_000, ge=1)
    device: Literal["cpu", "cuda"] = "cpu"
    run_dir: str = Field("runs", min_length=1)
    objective: str = Field("success", min_length=1)
    film: bool = True
    resume: str | None = None

    @property
    def driven_group(self) -> ResolvedGroup:
        """The first group that learns: the one that the objective and the best policy are of."""
        return next(group for group in self.external_groups if self.learning.frozen(group.name) is None)

    @model_validator(mode="after")
    def _groups_that_learn_are_there(self) -> Self:
        names, learning = [group.name for group in self.external_groups], self.learning
        faults = []
        for name in learning.groups:
            if name not in names:
                near = closest(name, names)
                remedy = f"did you mean {near}?" if near else f"choose {one_of(names)}"
                faults.append(f"learning.groups.{name}: there is no external group {name!r}; {remedy}")
                continue
            try:
                learning.of_group(name)
            except ValidationError as error:
                changes = learning.changes_of(name)
                lines = describe_faults(error, type(learning), changes)
                faults += [f"learning.groups.{name}.{line}" for line in lines]
        free = [name for name in names if learning.frozen(name) is None]
        if not free:
            faults.append(
                "every external group is frozen, so that nothing learns; leave out "
                f"learning.groups.{names[0]}.frozen, or evaluate the policies with python -m dune_rl.evaluate"
            )
        elif learning.population.probability and len(free) == 1:
            faults.append(
                "learning.population.probability: past opponents are of other groups that learn, and "
                f"{free[0]} alone does; set it to 0, or have another group learn (actors=learning_walkers)"
            )
        if faults:
            raise ValueError("\n".join(faults))
        return self

    @model_validator(mode="after")
    def _objective_is_a_metric(self) -> Self:
        known = [] if self.driven_group.metrics is None else metric_names(self.driven_group.metrics)
        if self.objective not in known:
            near = closest(self.objective, known)
            remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
            raise ValueError(f"objective: there is no metric {self.objective!r}; {remedy}")
        return self


class BenchmarkConf(EnvConf):
    """A measurement of what a step costs."""

    parts: tuple[
        Literal[
            "environment",
            "cameras",
            "sensors",
            "terrain",
            "new_world",
            "world_memory",
            "groups",
            "actors",
            "processes",
            "engines",
        ],
        ...,
    ] = (
        "environment",
        "cameras",
        "sensors",
        "terrain",
        "new_world",
        "groups",
        "actors",
        "processes",
    )
    scenes: int = Field(16, ge=1, le=8_192)
    rounds: int = Field(9, ge=1)
    steps: int = Field(60, ge=1)
    worlds: int = Field(500, ge=1)
    processes: tuple[Annotated[int, Field(ge=1)], ...] = (1, 2)
    seed: int = Field(0, ge=0)


BuiltInPolicy = Literal["go_to_goal", "mppi", "planner", "random"]


class ViewConf(EnvConf):
    """A look at an environment: pictures and a video, seen from behind `agent` (None: the first)."""

    view: Literal["sheet", "video", "both", "orbit", "map"] = "both"
    checkpoint: str | None = None
    policy: BuiltInPolicy | None = None
    agent: str | None = None
    seed: int = Field(0, ge=0)
    after_s: float = Field(3.0, ge=0.0)
    longest_s: float = Field(30.0, gt=0.0)
    frames_per_s: float = Field(10.0, gt=0.0, le=1_000.0)
    width: int = Field(960, ge=64, le=8192, multiple_of=2)
    height: int = Field(540, ge=64, le=8192, multiple_of=2)
    samples: int = Field(2, ge=1, le=4)
    episodes: int = Field(5, ge=1, le=100)
    dpi: int = Field(160, ge=72, le=600)
    out: str = Field("views", min_length=1)

    @model_validator(mode="after")
    def _one_driver(self) -> Self:
        if self.checkpoint is not None and self.policy is not None:
            raise ValueError("choose one driver: checkpoint=PATH or policy=NAME")
        return self

    @model_validator(mode="after")
    def _a_map_is_of_one_world(self) -> Self:
        drawn = [name for name in ("world_seed", "layout_seed") if name in self.randomisation.distributions]
        if self.view == "map" and drawn and (self.checkpoint or self.policy):
            raise ValueError(
                f"view=map shows one world, and randomisation.{drawn[0]} draws another for each episode: "
                "set randomisation=none"
            )
        return self


_BUILT_IN_POLICIES = get_args(BuiltInPolicy)


def _steps_kept(value: object) -> object:
    if isinstance(value, bool) or (isinstance(value, int) and value >= 1):
        return value
    raise ValueError(
        f"true writes a row for each step, a whole number N of at least 1 each N-th, false none (got {value})"
    )


Names = Annotated[tuple[Annotated[str, Field(min_length=1)], ...], BeforeValidator(_one_or_several)]


MOST_RUN_STEPS = 100_000


class EvaluateConf(EnvConf):
    """An evaluation of checkpoints, built-in policies and users' own, on the same episodes.

    `episodes` is None for all of the episode set, or 100 without one. With a `protocol` there are `runs` of
    `run_steps` control steps instead, None for those of the protocol.
    """

    checkpoint: Names = ()
    policy: Names = ()
    against: Names = ()
    set: str | None = None
    episodes: int | None = Field(None, ge=1)
    protocol: Literal["paper", "dune_code"] | None = None
    runs: int | None = Field(None, ge=1)
    run_steps: int | None = Field(None, ge=1, le=MOST_RUN_STEPS)
    scenes: int = Field(16, ge=1, le=8_192)
    seed: int = Field(0, ge=0)
    processes: int = Field(1, ge=1, le=1_024)
    steps: Annotated[bool | int, BeforeValidator(_steps_kept)] = False
    actor_steps: bool = False
    cross_play: bool = False
    populations: Names = ()
    out: str | None = Field(None, min_length=1)
    overwrite: bool = False

    @model_validator(mode="after")
    def _known_policies(self) -> Self:
        for key, names in (("policy", self.policy), ("against", self.against)):
            for name in names:
                if name in _BUILT_IN_POLICIES or ":" in name or name.endswith((".onnx", ".zip")):
                    continue
                if "/" in name or name.endswith(".pt"):
                    raise ValueError(f"{key}: {name} is no policy; did you mean checkpoint={name}?")
                near = closest(name, _BUILT_IN_POLICIES)
                meant = f"did you mean {near}? There are" if near else "there are"
                known = ", ".join((*_BUILT_IN_POLICIES, "FILE.onnx", "FILE.zip", "MODULE:FUNCTION"))
                raise ValueError(f"{key}: {name} is no policy; {meant} {known}")
        return self

    @model_validator(mode="after")
    def _actors_among_steps(self) -> Self:
        if self.actor_steps and not self.steps:
            raise ValueError("actor_steps=true adds rows to the steps; give steps=true or steps=N as well")
        return self

    @model_validator(mode="after")
    def _protocol_fits(self) -> Self:
        if self.protocol is None:
            for name in ("runs", "run_steps"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} needs protocol=paper or protocol=dune_code; or take episodes=N")
            return self
        if self.set is not None:
            raise ValueError(
                f"protocol={self.protocol} samples starts and goals as in training, and set={self.set} fixes "
                "them and how episodes end; leave one of the two out"
            )
        if self.episodes is not None:
            raise ValueError(
                f"protocol={self.protocol} has runs of control steps, whatever the number of episodes; "
                "write runs=N in place of episodes"
            )
        return self

    @model_validator(mode="after")
    def _cross_play_has_populations(self) -> Self:
        if self.cross_play and not self.populations:
            raise ValueError(
                "cross_play tests robots among populations of actors; name some: "
                "populations=[walkers,none,RUN], options of actors or runs that trained actors"
            )
        if self.populations and not self.cross_play:
            raise ValueError("populations are of a cross-play; give cross_play=true as well")
        if self.cross_play and self.protocol is not None:
            raise ValueError("cross_play counts episodes, and a protocol runs; leave protocol out")
        return self

    @model_validator(mode="after")
    def _some_policy(self) -> Self:
        if not (self.checkpoint or self.policy):
            raise ValueError(
                f"choose a policy: checkpoint=PATH, or policy=NAME with {', '.join(_BUILT_IN_POLICIES)}, "
                "FILE.onnx, FILE.zip or MODULE:FUNCTION"
            )
        return self
