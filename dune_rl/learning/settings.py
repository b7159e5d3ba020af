"""Settings of a training run that every algorithm has. Importing them loads neither PyTorch nor TorchRL."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from dune_rl.core.ray_cluster import is_elsewhere
from dune_rl.core.settings import Settings, merge_nested
from dune_rl.env.curriculum import CurriculumSettings

Width = Annotated[int, Field(ge=1, le=8192)]


class CollectorConf(Settings):
    """Processes that step the environments: `serial` is deterministic, `async` is fastest on one machine."""

    mode: Literal["serial", "sync", "async", "ray"] = "async"
    workers: int = Field(1, ge=1, le=1024, description="processes, in all modes but serial; ray: a CPU each")
    scenes: int = Field(16, ge=1, le=8192, description="scenes stepped as one batch, in each process")
    steps: int = Field(32, ge=1, description="steps of every scene between two hand-overs to the learner")

    episodes_per_worker: int | None = Field(
        None, ge=1, description="episodes after which worker processes are started anew; null: never"
    )

    @property
    def processes(self) -> int:
        """Worker processes beside the learner's own."""
        return 0 if self.mode == "serial" else self.workers

    @property
    def processes_here(self) -> int:
        """Those of them on this machine."""
        return 0 if self.mode == "ray" and is_elsewhere() else self.processes

    @property
    def frames_per_batch(self) -> int:
        """Control steps, over all scenes, in each batch that the learners are given."""
        return self.scenes * self.steps * (self.workers if self.mode == "sync" else 1)


class EvaluationConf(Settings):
    """When training pauses to evaluate its policies, and on how many episodes."""

    every_frames: int = Field(250_000, ge=1)
    episodes: int = Field(50, ge=1)
    scenes: int = Field(16, ge=1, le=8192, description="episodes run side by side; no result depends on it")
    tracks: int = Field(6, ge=0, description="first episodes whose tracks TensorBoard shows; 0: none")
    seed_offset: int = Field(1_000_003, ge=1, description="added to the run's seed; training never sees it")
    world_seeds: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] | None = Field(
        None, description="lowest and highest seed of worlds that training does not draw; null: its own"
    )


class CheckpointConf(Settings):
    """How often a run is saved; it is always saved at its end and when interrupted."""

    every_frames: int = Field(200_000, ge=1)
    replay: bool = Field(True, description="keep the replay buffer too; an interrupted run always does")


class PopulationConf(Settings):
    """Past policies as opponents: every so often a snapshot of each group that learns joins its pool.

    In a share of the episodes one group, drawn at random, acts as it does at present, and every other group
    that learns acts by a snapshot drawn from its own pool, without noise. A group learns nothing from what a
    snapshot of it did, and its statistics of training leave that out.
    """

    probability: float = Field(0.0, ge=0.0, le=1.0, description="share of episodes that have them")
    every_frames: int = Field(100_000, ge=1, description="frames between two snapshots")
    size: int = Field(5, ge=1, le=100, description="snapshots kept of each group, the latest")


# The key under `groups` of a policy's file, by which a group acts without learning.
FROZEN = "frozen"
# What a run has once, whatever its groups.
_OF_THE_RUN = (
    "name",
    "threads",
    "collector",
    "evaluation",
    "checkpoint",
    "population",
    "curriculum",
    "groups",
)


class LearningConf(Settings):
    """Base of the settings of every algorithm; `name` is the algorithm's name in the registry.

    `groups` has, by the name of an agent group, the settings that its learner has instead of these; with
    `frozen`, a run's folder or a policy's file, the group acts by that policy and does not learn, whatever
    else is set for it.
    """

    name: str
    start_from: str | None = Field(
        None, min_length=1, description="run or policy whose weights to begin with; null: random ones"
    )
    threads: int | None = Field(
        None, ge=1, description="of the learners; null: 1 if serial, else the cores left over, up to 4"
    )
    collector: CollectorConf = CollectorConf()
    evaluation: EvaluationConf = EvaluationConf()
    checkpoint: CheckpointConf = CheckpointConf()
    population: PopulationConf = PopulationConf()
    curriculum: CurriculumSettings | None = Field(
        None, description="difficulty of the training episodes; null: all as they are set"
    )
    groups: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _groups_set_what_is_theirs(self) -> Self:
        for group, changes in self.groups.items():
            taken = [name for name in changes if name in _OF_THE_RUN]
            if taken:
                raise ValueError(f"groups.{group}.{taken[0]}: all groups share it; set it for the run")
            frozen = changes.get(FROZEN)
            if frozen is not None and (not isinstance(frozen, str) or not frozen):
                raise ValueError(f"groups.{group}.{FROZEN} must be the path of a policy (got {frozen!r})")
        return self

    def frozen(self, group: str) -> str | None:
        """Where the policy is that `group` acts by without learning; None for a group that learns."""
        found: str | None = self.groups.get(group, {}).get(FROZEN)
        return found

    def start_of(self, group: str) -> tuple[str, str | None]:
        """The setting by which the learner of `group` starts from an earlier run, and where that is."""
        if self.frozen(group) is not None:
            return "", None
        own = "start_from" in self.groups.get(group, {})
        setting = f"learning.groups.{group}.start_from" if own else "learning.start_from"
        return setting, self.of_group(group).start_from

    def changes_of(self, group: str) -> dict[str, Any]:
        """All settings of the learner of `group`, as plain data, which need not be valid."""
        changes = {name: value for name, value in self.groups.get(group, {}).items() if name != FROZEN}
        return {**merge_nested(self.model_dump(), changes), "groups": {}}

    def of_group(self, group: str) -> Self:
        """The settings of the learner of `group`; raises pydantic's ValidationError for invalid ones."""
        if not self.groups.get(group):
            return self
        return type(self).model_validate(self.changes_of(group))

    def resolved(self, device: str) -> Self:
        """These settings with what depends on the machine decided for this one and a learner on `device`.

        A run uses and stores the resolved settings.
        """
        return self

    def notes_on_resuming(self, saved: Mapping[str, Any], device: str) -> list[str]:
        """What to tell the user of a run that was `saved` with other settings, or does not suit `device`."""
        return []
