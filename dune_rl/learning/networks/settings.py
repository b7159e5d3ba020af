"""Settings of the networks that algorithms have in common. Importing them loads no PyTorch."""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from dune_rl.core.settings import Settings
from dune_rl.learning.networks.registry import EncoderConf, parse_encoder
from dune_rl.learning.settings import LearningConf, Width
from dune_rl.state.command_grid import CommandGridConf

EncoderSettings = Annotated[SerializeAsAny[EncoderConf], BeforeValidator(parse_encoder)]


class NetworkConf(LearningConf):
    """Base of the settings of algorithms with the networks of `Architecture`, and a linear learning rate."""

    learning_rate: float = Field(3e-4, gt=0, description="at frame 0")
    final_learning_rate: float = Field(5e-5, gt=0, description="at total_frames, reached linearly")
    hidden: tuple[Width, ...] = Field((256, 256), min_length=1)
    scan_channels: int = Field(8, ge=0, le=1024, description="of the convolutions round the scans; 0: none")
    image_channels: tuple[Width, ...] = Field(
        (16, 32, 32), min_length=1, description="of the convolutions over each image, if there are any"
    )
    image_features: int = Field(64, ge=1, le=4096, description="values that each image is reduced to")
    networks: dict[str, EncoderSettings] = Field(
        default_factory=dict, description="encoder of a part of the observation, by sensor, in place of these"
    )
    observation_clip: float = Field(10.0, gt=0, description="bound on normalised observations")

    def learning_rate_at(self, share: float) -> float:
        """The learning rate after a `share` (0 to 1) of the run."""
        return self.learning_rate + share * (self.final_learning_rate - self.learning_rate)


class ReplayConf(Settings):
    """Where collected data are kept, and how much."""

    capacity: int = Field(1_000_000, ge=1)
    storage: Literal["memory", "disk"] = Field("memory", description="disk: a memory map in the run's folder")


class ReplayingConf(NetworkConf):
    """Base of the settings of algorithms that draw batches from a replay buffer."""

    batch_size: int = Field(512, ge=1)
    replay: ReplayConf = ReplayConf()

    @model_validator(mode="after")
    def _replay_holds_a_batch(self) -> Self:
        if self.replay.capacity < self.batch_size:
            raise ValueError(
                f"replay.capacity must be at least batch_size "
                f"(got {self.replay.capacity} and {self.batch_size})"
            )
        return self


class CommandsConf(NetworkConf):
    """Base of the settings of algorithms that choose one of a grid of commands."""

    commands: CommandGridConf = CommandGridConf()
    prior: str | None = Field(
        None,
        description="part of the observation with a first guess of each command's cost, to which the network "
        "adds: command_costs; null: none",
    )
    prior_weight: float = Field(
        1.0, ge=0, description="extra weight of that guess where a command is chosen: it counts 1 + this"
    )
    scan_channels: int = Field(16, ge=0, le=1024, description="of the convolutions round the scans; 0: none")

    def plain_commands(self) -> dict[str, Any]:
        """What describes the networks beside `Architecture.plain`."""
        weight = 0.0 if self.prior is None else self.prior_weight
        return {"commands": self.commands.model_dump(), "prior_weight": weight}


class ActorCriticConf(NetworkConf):
    """Base of the settings of algorithms that have an actor and critics."""

    batch_size: int = Field(512, ge=1)
    gamma: float = Field(0.99, ge=0, lt=1)
    reward_scale: float = Field(1.0, gt=0, description="multiplies the reward in the loss, never in the logs")
