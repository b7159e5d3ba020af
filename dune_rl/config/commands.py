"""Settings of the commands that evaluate, view and benchmark."""

import re
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from dune_rl.config.schema import EnvConf, Seed
from dune_rl.core.suggestions import closest, typed_word
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.ros.settings import LiveConf, NetworkConf


def _one_or_several(names: object) -> object:
    """A list of names, of one name or of none (null)."""
    return () if names is None else (names,) if isinstance(names, str) else names


BenchmarkPart = Literal[
    "environment", "cameras", "sensors", "terrain", "new_world", "groups", "actors", "processes", "engines",
    "world_memory", "learning", "sizes", "films",
]  # fmt: skip


class BenchmarkConf(EnvConf):
    """A measurement of what a step costs."""

    parts: tuple[BenchmarkPart, ...] = tuple(
        part
        for part in get_args(BenchmarkPart)
        if part not in ("world_memory", "engines", "learning", "sizes", "films")
    )
    scenes: int = Field(16, ge=1, le=8_192)
    rounds: int = Field(9, ge=1)
    steps: int = Field(60, ge=1)
    worlds: int = Field(500, ge=1)
    processes: tuple[Annotated[int, Field(ge=1)], ...] = (1, 2)
    algorithms: tuple[str, ...] = ("sac",)
    film_s: float = Field(60.0, gt=0.0)
    seed: Seed = 0


BuiltInPolicy = Literal["dwa", "dwa_oracle", "go_to_goal", "mppi", "oracle", "planner", "random"]
BUILT_IN_POLICIES = get_args(BuiltInPolicy)


class ViewConf(EnvConf):
    """A look at an environment and at `agent` (None: the first), in pictures, a film, a page or a 3D file."""

    view: Literal["sheet", "video", "both", "orbit", "map", "live", "html", "gltf"] = "both"
    checkpoint: str | None = None
    policy: BuiltInPolicy | None = None
    agent: str | None = None
    set: str | None = None
    seed: Seed = 0
    episode: int = Field(0, ge=0)
    after_s: float = Field(3.0, ge=0.0)
    longest_s: float = Field(60.0, gt=0.0)
    frames_per_s: float = Field(10.0, gt=0.0, le=1_000.0)
    width: int = Field(1920, ge=64, le=8192, multiple_of=2)
    height: int = Field(1080, ge=64, le=8192, multiple_of=2)
    samples: int = Field(2, ge=1, le=4)
    episodes: int = Field(5, ge=1, le=100)
    dpi: int = Field(160, ge=72, le=600)
    host: str = Field("127.0.0.1", min_length=1)
    port: int = Field(8080, ge=1, le=65_535)
    out: str = Field("views", min_length=1)

    @field_validator("out")
    @classmethod
    def _names_a_folder(cls, out: str) -> str:
        if re.search(r"\.(png|jpe?g|mp4|html|glb|gltf)$", out, re.IGNORECASE):
            raise ValueError(f"{out} is the name of a file; name the folder in which files get their own")
        return out

    @model_validator(mode="after")
    def _one_driver(self) -> Self:
        if self.checkpoint is not None and self.policy is not None:
            raise ValueError("choose one driver: checkpoint=PATH or policy=NAME")
        return self

    @model_validator(mode="after")
    def _a_map_is_of_one_world(self) -> Self:
        drawn = [name for name in ("world_seed", "layout_seed") if name in self.randomisation.distributions]
        if self.view == "map" and drawn and self.set is None and (self.checkpoint or self.policy):
            raise ValueError(
                f"view=map shows one world, and randomisation.{drawn[0]} draws another for each episode: "
                "set randomisation=none"
            )
        if self.view == "map" and self.episode and not (self.set or self.checkpoint or self.policy):
            raise ValueError(
                f"view=map shows episode={self.episode} of a set=NAME, or as a checkpoint=PATH or "
                "policy=NAME drives it; without one it shows examples of starts and goals: leave episode out"
            )
        return self


class GazeboConf(EnvConf):
    """The export of a scene for Gazebo: its world, `duration_s` of its actors' motion, and its robots."""

    seed: Seed = 0
    duration_s: float = Field(60.0, gt=0.0, le=3_600.0)
    out: str | None = Field(None, min_length=1)
    overwrite: bool = False

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if self.out is None:
            raise ValueError("out is missing; name the folder to write: out=FOLDER")
        return self


class RosConf(EnvConf, NetworkConf, LiveConf):
    """A scene on live topics of ROS 2; a `checkpoint` brings the settings of its run."""

    checkpoint: str | None = None
    seed: Seed = 0
    episode: int = Field(0, ge=0)


class ForecastConf(EnvConf):
    """The learning of a motion forecast from `episodes` that `policy` drives."""

    policy: BuiltInPolicy = "dwa"
    episodes: int = Field(450, ge=1, le=10_000_000)
    scenes: int = Field(16, ge=1, le=8_192)
    seed: Seed = 0
    held_out: float = Field(0.15, gt=0.0, lt=1.0)
    updates: int = Field(20_000, ge=2)
    batch_size: int = Field(512, ge=1, le=1_000_000)
    out: str | None = Field(None, min_length=1)


def _steps_kept(value: object) -> object:
    if isinstance(value, bool) or (isinstance(value, int) and value >= 1):
        return value
    raise ValueError(
        f"true writes a row for each step, a whole number N of at least 1 each N-th, false none (got {value})"
    )


RAY = "ray"
MOST_PROCESSES = 1_024


def _processes(value: object) -> object:
    if value == RAY or (isinstance(value, int) and 1 <= value <= MOST_PROCESSES):
        return value
    raise ValueError(
        f"a whole number from 1 to {MOST_PROCESSES}, or {RAY} for all CPUs of a Ray cluster (got {value})"
    )


def _part(value: str) -> str:
    number, _, parts = value.partition("/")
    if number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts):
        return value
    raise ValueError(f"K/N is the K-th of N parts of the episodes, as 1/16 (got {value})")


# Minari's pattern of names with a version, without empty folders in the namespace.
_DATASET_ID = re.compile(r"([-\w]{2,}/)*[-\w]+-v\d+", re.ASCII)


def _dataset_id(value: str) -> str:
    if _DATASET_ID.fullmatch(value):
        return value
    raise ValueError(
        "NAMESPACE/NAME-vN names a dataset of Minari, as dune_rl/flat/planner-v0: of letters, digits, - and "
        f"_, and at least two of them in each part of the namespace (got {value})"
    )


Processes = Annotated[int | Literal["ray"], BeforeValidator(_processes)]


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
    episodes: int | None = Field(None, ge=1, le=10_000_000)
    protocol: Literal["paper", "dune_code"] | None = None
    runs: int | None = Field(None, ge=1)
    run_steps: int | None = Field(None, ge=1, le=MOST_RUN_STEPS)
    scenes: int = Field(16, ge=1, le=8_192)
    seed: Seed = 0
    processes: Processes = 1
    steps: Annotated[bool | int, BeforeValidator(_steps_kept)] = False
    actor_steps: bool = False
    bag: str | None = Field(None, min_length=1)
    cross_play: bool = False
    populations: Names = ()
    part: Annotated[str, AfterValidator(_part)] | None = None
    dataset: Annotated[str, AfterValidator(_dataset_id)] | None = None
    out: str | None = Field(None, min_length=1)
    overwrite: bool = False

    @field_validator("randomisation")
    @classmethod
    def _draw_every_world(cls, value: RandomisationConf) -> RandomisationConf:
        return value.with_new_worlds()

    @model_validator(mode="after")
    def _known_policies(self) -> Self:
        for key, names in (("policy", self.policy), ("against", self.against)):
            for name in names:
                if name in BUILT_IN_POLICIES or ":" in name or name.endswith(".onnx"):
                    continue
                if name.endswith(".zip"):
                    raise ValueError(
                        f"{key}: {name} must be loaded by a function of yours: write {key}=MODULE:FUNCTION "
                        "(docs/how_to/evaluate.md has one for Stable-Baselines3)"
                    )
                if "/" in name or name.endswith(".pt"):
                    raise ValueError(
                        f"{key}: {name} is no policy; did you mean {typed_word('checkpoint', name)}?"
                    )
                near = closest(name, BUILT_IN_POLICIES)
                meant = f"did you mean {near}? There are" if near else "there are"
                known = ", ".join((*BUILT_IN_POLICIES, "FILE.onnx", "MODULE:FUNCTION"))
                raise ValueError(f"{key}: {name} is no policy; {meant} {known}")
        return self

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        fault = self._fault_of_dataset()
        alone = [name for name in ("runs", "run_steps") if getattr(self, name) is not None]
        faults = (
            (
                self.actor_steps and not self.steps,
                "actor_steps=true adds rows to the steps; give steps=true or steps=N as well",
            ),
            (
                self.protocol is None and alone,
                f"{''.join(alone[:1])} needs protocol=paper or protocol=dune_code; or take episodes=N",
            ),
            (
                self.protocol is not None and self.set is not None,
                f"protocol={self.protocol} samples starts and goals as in training, and set={self.set} fixes "
                "them and how episodes end; leave one of the two out",
            ),
            (
                self.protocol is not None and self.episodes is not None,
                f"protocol={self.protocol} has runs of control steps, whatever the number of episodes; "
                "write runs=N in place of episodes",
            ),
            (
                self.cross_play and not self.populations,
                "cross_play tests robots among populations of actors; name some: "
                "populations=[walkers,none,RUN], options of actors or runs that trained actors",
            ),
            (
                self.populations and not self.cross_play,
                "populations are of a cross-play; give cross_play=true as well",
            ),
            (
                self.bag is not None and (self.protocol is not None or self.cross_play),
                f"bag={self.bag} records the episodes of one evaluation; leave it out, or "
                f"{'cross_play' if self.cross_play else 'protocol'}",
            ),
            (
                self.cross_play and self.part is not None,
                "cross_play has no parts; leave part out",
            ),
            (
                self.cross_play and self.protocol is not None,
                "cross_play counts episodes, and a protocol runs; leave protocol out",
            ),
            (bool(fault), fault),
            (
                not (self.checkpoint or self.policy),
                f"choose a policy: checkpoint=PATH, or policy=NAME with {', '.join(BUILT_IN_POLICIES)}, "
                "FILE.onnx or MODULE:FUNCTION",
            ),
        )
        for is_fault, message in faults:
            if is_fault:
                raise ValueError(message)
        return self

    def _fault_of_dataset(self) -> str:
        """Why the episodes cannot be a dataset; empty where they can, or none is asked for."""
        if self.dataset is None:
            return ""
        dataset = f"dataset={self.dataset}"
        beside = (
            ("protocol", self.protocol is not None, "whose last episodes are cut off; take episodes=N"),
            ("cross_play", self.cross_play, "which has many evaluations; make a dataset of each"),
            ("part", self.part is not None, "which has some of the episodes; take processes=N"),
            ("processes=ray", self.processes == RAY, "whose nodes share no folder; take processes=N"),
        )
        for name, is_set, reason in beside:
            if is_set:
                return f"{dataset} does not go with {name}, {reason}"
        if len({*self.checkpoint, *self.policy, *self.against}) > 1:
            return f"{dataset} is of one policy; evaluate each into a dataset of its own"
        groups = self.external_groups
        agents = [agent for group in groups for agent in group.agents]
        if len(agents) > 1:
            return f"{dataset} is of one agent, as Gymnasium has it, and here are {', '.join(agents)}"
        if groups[0].presence is not None:
            return f"{dataset} is of an agent that is there in all of an episode; leave its presence out"
        return ""
