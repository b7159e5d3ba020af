"""Settings of imitation. Importing them loads neither PyTorch nor TorchRL."""

from typing import Literal

from pydantic import Field, field_validator

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.learning.networks.settings import CommandsConf, ReplayingConf


class ImitationConf(CommandsConf, ReplayingConf):
    """Imitation of a driver that labels what the learning policy meets (DAgger: Ross et al., 2011)."""

    name: Literal["imitation"] = "imitation"
    teacher: str = Field("planner", min_length=1, description="driver whose costs, or actions, are learned")
    learning_rate: float = Field(1e-3, gt=0, description="at frame 0")
    final_learning_rate: float = Field(1e-4, gt=0, description="at total_frames, reached linearly")
    learning_starts: int = Field(
        40_000, ge=0, description="frames before the first update: the teacher drives"
    )
    teacher_share: float = Field(
        0.1, ge=0, le=1, description="of later episodes, in which the teacher drives"
    )
    noise_share: float = Field(
        0.2,
        ge=0,
        le=1,
        description="of episodes with bursts of random actions; twice as many of the teacher's",
    )
    updates_per_frame: float = Field(
        0.02, gt=0, description="gradient updates for each action taken; held ones count once"
    )
    batch_size: int = Field(1024, ge=1)
    max_cost: float = Field(
        8.0, gt=0, description="of a command above the best one's, in metres of level way"
    )
    change_cost: float = Field(
        0.0,
        ge=0,
        description="for each m/s and rad that a command differs from the last one, in metres",
    )
    standing_cost: float = Field(
        0.0,
        ge=0,
        description="for a command of no speed, also a turn on the spot, in metres: against needless halts",
    )
    temperature: float = Field(0.1, gt=0, description="of the costs, where they make probabilities")

    @field_validator("teacher")
    @classmethod
    def _known(cls, value: str) -> str:
        if BEHAVIOURS.find(value) is None:
            raise ValueError(BEHAVIOURS.unknown(value))
        return value
