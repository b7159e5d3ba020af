"""Hyperparameters of soft actor-critic. Importing them loads neither PyTorch nor TorchRL."""

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.learning.networks.settings import ActorCriticConf, ReplayingConf


class DemonstrationsConf(Settings):
    """Data that a driver collects before learning begins, of which every batch then has a share.

    It follows RLPD (Ball et al. 2023). The driver may know what the policy does not observe.
    """

    driver: str = Field("planner", min_length=1, description="driver: planner, mppi, go_to_goal or another")
    frames: int = Field(50_000, ge=1, description="frames that it drives, in place of the warm-up")
    share: float = Field(0.5, gt=0, lt=1, description="of the transitions in each update")


class MaximumEntropyConf(ReplayingConf, ActorCriticConf):
    """Base of the settings of soft actor-critic and its variants, which have a replay buffer."""

    entropy_learning_rate: float = Field(
        3e-3, gt=0, description="of the entropy coefficient, falling in step with the other"
    )
    learning_starts: int = Field(50_000, ge=0, description="frames before the first update")
    warm_up: Literal["random", "go_to_goal", "policy"] = Field(
        "go_to_goal",
        description="policy that acts in them; policy: its own, with its noise, as with start_from",
    )
    updates_per_frame: float = Field(
        0.0625, gt=0, description="gradient updates for each action taken; held ones count once"
    )
    n_steps: int = Field(8, ge=1, le=64, description="of reward before the bootstrap; 1 is plain SAC")
    initial_entropy_coefficient: float = Field(0.5, gt=0)
    target_entropy: float | None = Field(
        None, description="nats, for actions scaled to [-1, 1]; null: minus the number of action components"
    )
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="of the networks' products; auto: bfloat16 where the processor is faster at it"
    )
    demonstrations: DemonstrationsConf | None = Field(
        None, description="data of a driver that are learned from as well; null: none"
    )

    def resolved(self, device: str) -> Self:
        """These settings with the `precision` that `auto` comes to on `device` of this machine."""
        if self.precision != "auto":
            return self
        precision = "bfloat16" if has_fast_bfloat16(device) else "float32"
        return self.model_copy(update={"precision": precision})

    def notes_on_resuming(self, saved: Mapping[str, Any], device: str) -> list[str]:
        """A note where the precision changes, or is one that `device` is slow at."""
        before = saved.get("precision", "auto")
        if before not in ("auto", self.precision):
            return [f"the run goes on with learning.precision={self.precision}; before, it was {before}"]
        if self.precision == "bfloat16" and not has_fast_bfloat16(device):
            return [
                "the run began with learning.precision=bfloat16, at which this processor is slower than "
                "at float32: it goes on so; learning.precision=auto or float32 changes it"
            ]
        return []


class SacConf(MaximumEntropyConf):
    """Soft actor-critic; the defaults are those of the DUnE paper where it states them."""

    name: Literal["sac"] = "sac"
    tau: float = Field(0.005, gt=0, le=0.5, description="share of the new weights in each target update")


def has_fast_bfloat16(device: str) -> bool:
    """Whether an update is faster in bfloat16 than in float32 on `device`, a GPU or a CPU.

    It is on GPUs with native bfloat16, and on CPUs with matrix tiles (AMX) or vector instructions
    (AVX-512 BF16) for it: with the latter, an update took 12 ms instead of 26 ms (experiments/speed).
    """
    # Imported here: the command lines import this module, and many of them do not need PyTorch.
    import torch

    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    found = torch.cpu.get_capabilities()
    return any(found.get(name, False) for name in ("amx_bf16", "avx512_bf16"))
