"""Hyperparameters of CrossQ. Importing them loads neither PyTorch nor TorchRL."""

from typing import Literal

from pydantic import Field

from dune_rl.learning.sac.settings import MaximumEntropyConf


class CrossqConf(MaximumEntropyConf):
    """CrossQ: soft actor-critic whose critics are batch-normalised and have no targets."""

    name: Literal["crossq"] = "crossq"
    learning_rate: float = Field(1e-3, gt=0, description="at frame 0")
    final_learning_rate: float = Field(1e-4, gt=0, description="at total_frames, reached linearly")
    batch_size: int = Field(512, ge=16, description="transitions, whose statistics normalise the critics")
    norm_momentum: float = Field(
        0.01, gt=0, le=1, description="share of a batch in the running statistics of the critics"
    )
    norm_warm_up: int = Field(
        5_000, ge=1, description="updates before the running statistics correct those of a batch"
    )
