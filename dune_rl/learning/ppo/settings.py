"""Hyperparameters of proximal policy optimisation. Importing them loads neither PyTorch nor TorchRL."""

from typing import Literal

from pydantic import Field

from dune_rl.learning.networks.settings import ActorCriticConf
from dune_rl.learning.settings import CollectorConf


class PpoConf(ActorCriticConf):
    """Proximal policy optimisation; each batch of the collector is learned from, and dropped."""

    name: Literal["ppo"] = "ppo"
    learning_rate: float = Field(5e-4, gt=0, description="at frame 0")
    epochs: int = Field(8, ge=1, le=100, description="passes over each collected batch")
    clip: float = Field(0.2, gt=0, lt=1, description="of the ratio of probabilities, around 1")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="of the advantages: 0 one step, 1 whole returns")
    entropy_coefficient: float = Field(0.003, ge=0)
    critic_coefficient: float = Field(0.5, gt=0)
    max_gradient_norm: float = Field(0.5, gt=0)
    initial_scale: float = Field(
        0.7, gt=0.01, lt=7, description="of the noise on actions before they are squashed into their bounds"
    )
    reward_scale: float = Field(0.1, gt=0, description="multiplies the reward in the loss, never in the logs")
    central_critic: bool = Field(
        False, description="whether the critic sees what all agents of the group observe (MAPPO)"
    )
    recurrent: int = Field(
        0, ge=0, le=4096, description="units of a GRU, by which a policy remembers its episode; 0: none"
    )
    collector: CollectorConf = CollectorConf(mode="sync", steps=128)
