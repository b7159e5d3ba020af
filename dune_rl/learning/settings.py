"""Settings of a training run that every algorithm has. Importing them loads neither PyTorch nor TorchRL."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from dune_rl.settings import Settings

Width = Annotated[int, Field(ge=1, le=8192)]


class CollectorConf(Settings):
    """Who steps the environments: `serial` is deterministic, `async` is fastest."""

    mode: Literal["serial", "sync", "async"] = "async"
    workers: int = Field(1, ge=1, le=1024, description="processes, in the modes sync and async")
    scenes: int = Field(16, ge=1, le=8192, description="scenes stepped as one batch, in each process")
    steps: int = Field(32, ge=1, description="steps of every scene between two hand-overs to the learner")

    @property
    def processes(self) -> int:
        """Worker processes beside the learner's own."""
        return 0 if self.mode == "serial" else self.workers

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


class CheckpointConf(Settings):
    """How often a run is saved; it is always saved at its end and when interrupted."""

    every_frames: int = Field(200_000, ge=1)
    replay: bool = Field(True, description="keep the replay buffer too; an interrupted run always does")


class LearningConf(Settings):
    """Base of the settings of every algorithm; `name` is the algorithm's name in the registry."""

    name: str
    threads: int | None = Field(
        None, ge=1, description="of the learners; null: 1 if serial, else the cores left over, up to 4"
    )
    collector: CollectorConf = CollectorConf()
    evaluation: EvaluationConf = EvaluationConf()
    checkpoint: CheckpointConf = CheckpointConf()

    def resolved(self, device: str) -> Self:
        """These settings with what depends on the machine decided for this one and a learner on `device`.

        A run uses and stores what comes out, so that it says what it did.
        """
        return self

    def notes_on_resuming(self, saved: Mapping[str, Any], device: str) -> list[str]:
        """What to tell the user of a run that was `saved` with other settings, or does not suit `device`."""
        return []
