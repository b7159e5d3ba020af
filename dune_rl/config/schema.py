"""Every setting there is: one class for training, one for evaluation, both around an environment's."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from dune_rl.config.actors import ActorConf
from dune_rl.config.worlds import WorldConf
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.learning.checkpoint import CheckpointConf
from dune_rl.learning.collect import CollectorConf
from dune_rl.learning.evaluation import EvaluationConf
from dune_rl.learning.replay import ReplayConf
from dune_rl.learning.sac import SacConf
from dune_rl.metrics.episode import MetricsConf
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.hyperdog.robot import HyperDogConf
from dune_rl.robots.leo_rover.robot import LeoRoverConf
from dune_rl.robots.rover_zero.robot import RoverZeroConf
from dune_rl.robots.urdf.robot import UrdfConf
from dune_rl.sensors.conf import SensorsConf
from dune_rl.settings import Settings
from dune_rl.tasks.task import TaskConf

RobotConf = Annotated[RoverZeroConf | LeoRoverConf | HyperDogConf | UrdfConf, Field(discriminator="name")]


class EnvConf(Settings):
    """What an environment is made of; the world has no default.

    `robots`, where they are given, take the place of the one `robot`.
    """

    world: WorldConf
    weather: WeatherConf = WeatherConf()
    robot: RobotConf = RoverZeroConf()
    robots: Annotated[tuple[RobotConf, ...], Field(min_length=1)] | None = None
    actors: tuple[ActorConf, ...] = ()
    sensors: SensorsConf = SensorsConf()
    physics: PhysicsConf = PhysicsConf()
    task: TaskConf = TaskConf()
    metrics: MetricsConf = MetricsConf()
    randomisation: RandomisationConf = RandomisationConf()

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        self.randomisation.check(self.world, self.weather)
        return self

    @model_validator(mode="after")
    def _rates_fit(self) -> Self:
        self.sensors.realism.check(self.physics.control_step_s)
        return self

    @model_validator(mode="after")
    def _mounts_stand_over_the_ground(self) -> Self:
        heights = [robot.standing_height_m for robot in self.all_robots]
        height = min((known for known in heights if known is not None), default=None)
        for name in ("lidar", "lidar_3d", "depth_strip", "camera"):
            mount = getattr(self.sensors, name).mount_b
            if mount is not None and height is not None and mount[2] <= -height:
                raise ValueError(
                    f"sensors.{name}.mount_b lies in the ground: its third value, up of the robot's origin, "
                    f"must be above {-height:g} (got {mount[2]:g})"
                )
        return self

    @property
    def all_robots(self) -> tuple[RobotConf, ...]:
        """The robots of a scene."""
        return (self.robot,) if self.robots is None else self.robots


class SingleAgentConf(EnvConf):
    """An environment whose only agent is the rover."""

    @model_validator(mode="after")
    def _one_robot(self) -> Self:
        if self.robots is not None:
            raise ValueError(
                "robots are agents of parallel_env alone; choose one here: robot="
                + (self.robots[0].name if len(self.robots) == 1 else "NAME")
            )
        return self

    @model_validator(mode="after")
    def _all_actors_scripted(self) -> Self:
        if any(actor.controller == "external" for actor in self.actors):
            raise ValueError(
                "only the rover is an agent here; take scripted actors (actors=walkers) or parallel_env"
            )
        return self


class LearningConf(SacConf):
    """Soft actor-critic and the machinery around it."""

    replay: ReplayConf = ReplayConf()
    collector: CollectorConf = CollectorConf()
    evaluation: EvaluationConf = EvaluationConf()
    checkpoint: CheckpointConf = CheckpointConf()

    @model_validator(mode="after")
    def _replay_holds_a_batch(self) -> Self:
        if self.replay.capacity < self.batch_size:
            raise ValueError(
                f"replay.capacity must be at least batch_size "
                f"(got {self.replay.capacity} and {self.batch_size})"
            )
        return self


class Conf(SingleAgentConf):
    """A training run."""

    learning: LearningConf = LearningConf()
    seed: int = Field(1, ge=0)
    total_frames: int = Field(2_500_000, ge=1)
    device: Literal["cpu", "cuda"] = "cpu"
    run_dir: str = Field("runs", min_length=1)
    resume: str | None = None


class BenchmarkConf(EnvConf):
    """A measurement of what a step costs."""

    parts: tuple[
        Literal[
            "environment", "cameras", "sensors", "terrain", "new_world", "groups", "processes", "engines"
        ],
        ...,
    ] = (
        "environment",
        "cameras",
        "sensors",
        "terrain",
        "new_world",
        "groups",
        "processes",
    )
    scenes: int = Field(16, ge=1)
    rounds: int = Field(9, ge=1)
    steps: int = Field(60, ge=1)
    processes: tuple[Annotated[int, Field(ge=1)], ...] = (1, 2)
    seed: int = Field(0, ge=0)


class ViewConf(SingleAgentConf):
    """A look at an environment: pictures and a video."""

    view: Literal["sheet", "video", "both", "orbit", "map"] = "both"
    checkpoint: str | None = None
    policy: Literal["go_to_goal", "random"] | None = None
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
        drawn = [name for name in ("world_seed", "layout_seed") if name in self.randomisation.drawn]
        if self.view == "map" and drawn and (self.checkpoint or self.policy):
            raise ValueError(
                f"view=map shows one world, and randomisation.{drawn[0]} draws another for each episode: "
                "set randomisation=none"
            )
        return self


class EvaluateConf(SingleAgentConf):
    """An evaluation of a checkpoint or of a built-in policy."""

    checkpoint: str | None = None
    policy: Literal["go_to_goal", "random"] | None = None
    against: Literal["go_to_goal", "random"] | None = None
    episodes: int = Field(100, ge=1)
    scenes: int = Field(16, ge=1)
    seed: int = Field(0, ge=0)
    out: str | None = None

    @model_validator(mode="after")
    def _one_policy(self) -> Self:
        if (self.checkpoint is None) == (self.policy is None):
            raise ValueError("choose one policy: checkpoint=PATH, policy=go_to_goal or policy=random")
        return self
