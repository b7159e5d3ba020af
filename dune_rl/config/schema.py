"""Every setting there is: one class for training, one for evaluation, both around an environment's."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationError, model_validator

from dune_rl.config.agents import PRESETS, SHARED, AgentGroupConf, AgentGroups, ResolvedGroup, preset_settings
from dune_rl.config.checks import describe_faults
from dune_rl.config.shorthands import write_agents
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import advise
from dune_rl.env.randomisation import RANDOMISATIONS, RandomisationConf
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.learning.settings import LearningConf
from dune_rl.metrics.episode import MetricsConf, metric_names
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.conf import Sensors, check_timing, default_sensors
from dune_rl.tasks.registry import ROBOT_REWARDS, TERMINATIONS
from dune_rl.tasks.task import DIVERGED, POINT_GOAL_TERMINATIONS, TaskConf
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import WorldSettings

WorldConf = Annotated[SerializeAsAny[WorldSettings], BeforeValidator(WORLDS.parse_settings)]
AlgorithmConf = Annotated[SerializeAsAny[LearningConf], BeforeValidator(ALGORITHMS.parse_settings)]
# Of as many bits as tables keep of it.
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class EnvConf(Settings):
    """What an environment is made of; the world has no default.

    `agents` are the agent groups of a scene. Instead of them `robot`, or several `robots`, and `actors`,
    which are groups beside the robots', can be given: they write into `agents`. `sensors`, `task` and
    `metrics` are those of the groups that share them.
    """

    world: WorldConf
    weather: WeatherConf = WeatherConf()
    agents: Annotated[AgentGroups, Field(min_length=1)]
    sensors: Sensors = Field(default_factory=default_sensors)
    physics: PhysicsConf = PhysicsConf()
    task: TaskConf = TaskConf()
    metrics: MetricsConf = MetricsConf()
    randomisation: RandomisationConf = RandomisationConf()
    shield: Literal["none", "brake"] = Field(
        "none", description="brake: robots brake or turn before what their LiDAR sees"
    )

    @model_validator(mode="before")
    @classmethod
    def _shorthands_write_agents(cls, data: Any) -> Any:
        return write_agents(data) if isinstance(data, Mapping) else data

    @property
    def groups(self) -> tuple[ResolvedGroup, ...]:
        """The agent groups of a scene, in order, with settings in the place of presets."""
        return tuple(self._resolved(name, group) for name, group in self.agents.items())

    def _resolved(self, name: str, group: AgentGroupConf) -> ResolvedGroup:
        values = {key: getattr(group, key) for key in AgentGroupConf.model_fields}
        for section in PRESETS:
            if isinstance(values[section], str):
                values[section] = preset_settings(section, values[section], getattr(self, section))
        if group.metrics == SHARED and not group.is_robot:
            # These bodies have no motors.
            values["metrics"] = self.metrics.model_copy(update={"energy": False})
        return ResolvedGroup(name=name, **values)

    @property
    def robot(self) -> RobotSettings:
        return next(group.body for group in self.agents.values() if isinstance(group.body, RobotSettings))

    @property
    def actors(self) -> dict[str, AgentGroupConf]:
        """The groups beside those of robots."""
        return {name: group for name, group in self.agents.items() if not group.is_robot}

    def path_of(self, group: str) -> str:
        """The path of a group's settings, such as `agents.walker`."""
        return f"agents.{group}"

    def require_endings(self) -> None:
        """Raise ValueError unless some external group has a termination that ends its episodes."""
        external = self.external_groups
        endings = [[] if one.task is None else one.task.terminations.values() for one in external]
        if all(term.renew for terms in endings for term in terms):
            name = external[0].name
            path = "task" if self.agents[name].task == SHARED else f"{self.path_of(name)}.task"
            raise ValueError(
                f"{path}.terminations: no episode ends, as nothing but another goal follows a goal; add "
                f"'+{path}.terminations.time_limit={{max_steps: 2000}}'"
            )

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
    def _visitors_come_in_time(self) -> Self:
        ends = [
            [] if group.task is None else group.task.terminations.values() for group in self.external_groups
        ]
        limits = [[term for term in terms if term.term == "time_limit"] for terms in ends]
        if not all(limits):
            return self
        steps: list[int] = [getattr(term, "max_steps") for terms in limits for term in terms]  # noqa: B009
        longest_s = max(steps) * self.physics.control_step_s
        for group in self.groups:
            if group.presence is not None and group.presence.arrive_s[0] >= longest_s:
                raise ValueError(
                    f"{self.path_of(group.name)}.presence.arrive_s: episodes end after {longest_s:g} s, "
                    f"before anybody comes (from {group.presence.arrive_s[0]:g} s on); let them come "
                    "earlier, or raise task.terminations.time_limit.max_steps"
                )
        return self

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        self.randomisation.check(self.world, self.weather)
        return self

    @model_validator(mode="after")
    def _rates_fit(self) -> Self:
        for path, sensors in self._sensing_groups():
            check_timing(sensors, self.physics.control_step_s, path)
        return self

    @model_validator(mode="after")
    def _named_parts_exist(self) -> Self:
        """Sensors, rewards, controllers and metrics name groups and terminations that are there."""
        groups = self.groups
        names = [group.name for group in groups]
        for path, sensors in self._sensing_groups():
            observed = [conf.privileged for conf in sensors.values() if conf.observed]
            if observed and all(observed):
                raise ValueError(f"{path}: all are privileged, so that policies observe nothing; add another")
            for sensor, conf in sensors.items():
                for name in getattr(conf, "groups", ()):
                    _require(f"{path}.{sensor}.groups", "group", name, names)
        for group in groups:
            path = self.path_of(group.name)
            robots = [
                each.name for each in groups if isinstance(each.body, RobotSettings) and each is not group
            ]
            for name, term in () if group.task is None else group.task.rewards.items():
                for other in getattr(term, "groups", ()) if term.term in ROBOT_REWARDS else ():
                    _require(f"{path}.task.rewards.{name}.groups", "other group of robots", other, robots)
            target = getattr(group.controller, "target", None)
            if isinstance(target, str):
                _require(f"{path}.controller.target", "group", target, ["robots", *names])
            # The task may leave out what others have: that is never the end of an episode then.
            own = () if group.task is None else group.task.terminations
            endings = sorted({*own, *TERMINATIONS.names(), DIVERGED, *POINT_GOAL_TERMINATIONS})
            for name, metric in () if group.metrics is None else group.metrics.terms.items():
                ending = getattr(metric, "termination", DIVERGED)
                _require(f"metrics.terms.{name}.termination", "termination", ending, endings)
        return self

    def _sensing_groups(self) -> list[tuple[str, Sensors]]:
        """The different sensors of all groups, and where they are set."""
        found: dict[str, Sensors] = {}
        for group in self.groups:
            if group.sensors is self.sensors:
                found["sensors"] = group.sensors
            elif group.sensors is not None:
                found[f"{self.path_of(group.name)}.sensors"] = group.sensors
        return list(found.items())


def _require(path: str, kind: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        remedy = advise(name, known) if known else "choose none: []"
        raise ValueError(f"{path}: there is no {kind} {name!r}; {remedy}")


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

    learning: AlgorithmConf = Field(default_factory=lambda: ALGORITHMS.parse_settings({"name": "sac"}))
    seed: Seed = 1
    total_frames: int = Field(2_500_000, ge=1, lt=2**63)
    device: Literal["cpu", "cuda"] = "cpu"
    run_dir: str = Field("runs", min_length=1)
    objective: str = Field("success", min_length=1)
    film: bool = True
    resume: str | None = None

    @property
    def driven_group(self) -> ResolvedGroup:
        return next(group for group in self.external_groups if self.learning.frozen(group.name) is None)

    @model_validator(mode="after")
    def _groups_that_learn_are_there(self) -> Self:
        names, learning = [group.name for group in self.external_groups], self.learning
        faults = []
        for name in learning.groups:
            if name not in names:
                remedy = advise(name, names)
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
    def _evaluations_have_worlds_of_their_own(self) -> Self:
        seeds, drawn = (
            self.learning.evaluation.world_seeds,
            self.randomisation.distributions.get("world_seed"),
        )
        if seeds is None:
            return self
        setting = f"learning.evaluation.world_seeds=[{seeds[0]},{seeds[1]}]"
        own_seed = getattr(self.world, "seed", None)
        if own_seed is None:
            raise ValueError(f"{setting}: world={self.world.name} has no seed; leave it null")
        low, high = (own_seed, own_seed) if drawn is None else drawn.limits
        if seeds[0] > seeds[1]:
            raise ValueError(f"{setting}: the first must not be above the second")
        if seeds[0] <= high and low <= seeds[1]:
            raise ValueError(
                f"{setting}: training draws worlds of the seeds {low:.0f} to {high:.0f} itself; choose "
                f"others, such as [{high + 1:.0f},{high + 1000:.0f}]"
            )
        return self

    @model_validator(mode="after")
    def _episodes_end(self) -> Self:
        self.require_endings()
        return self

    @model_validator(mode="after")
    def _measured_metrics_exist(self) -> Self:
        known = [] if self.driven_group.metrics is None else metric_names(self.driven_group.metrics)
        curriculum = self.learning.curriculum
        measured = {"objective": self.objective}
        if curriculum is not None:
            measured["learning.curriculum.measure"] = curriculum.measure
        for setting, metric in measured.items():
            if metric not in known:
                raise ValueError(f"{setting}: there is no metric {metric!r}; {advise(metric, known)}")
        drawn = list(self.randomisation.distributions)
        for name in () if curriculum is None else curriculum.easiest:
            if name not in drawn:
                known = RANDOMISATIONS.names()
                remedy = f"randomisation.{name} draws it" if name in known else advise(name, drawn or known)
                raise ValueError(f"learning.curriculum.easiest.{name}: it is not drawn; {remedy}")
            if name.endswith("seed"):
                raise ValueError(f"learning.curriculum.easiest.{name}: no seed is easier than another")
        return self
