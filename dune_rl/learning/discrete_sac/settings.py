"""Hyperparameters of discrete soft actor-critic. Importing them loads neither PyTorch nor TorchRL."""

from typing import Literal

from pydantic import Field

from dune_rl.learning.networks.settings import CommandsConf
from dune_rl.learning.sac.settings import MaximumEntropyConf


class DiscreteSacConf(CommandsConf, MaximumEntropyConf):
    """Soft actor-critic that chooses one of a grid of commands; its policy has the network of `imitation`."""

    name: Literal["discrete_sac"] = "discrete_sac"
    prior_weight: float = Field(0.0, ge=0, description="extra weight of that guess: it counts 1 + this")
    initial_entropy_coefficient: float = Field(0.02, gt=0)
    target_entropy: float | None = Field(
        None, description="nats; null: a quarter of what equally likely commands have"
    )
    critic_updates: int = Field(
        0, ge=0, description="first updates, in which the policy's weights stay as they are"
    )
    target_divergence: float | None = Field(
        None,
        gt=0,
        description="nats from the policy of start_from, or else from the prior, whose price then replaces "
        "the bonus for entropy",
    )
    tau: float = Field(0.005, gt=0, le=0.5, description="share of the new weights in each target update")
