"""Soft actor-critic: its settings, and one object that turns batches into weights."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from torch import Tensor
from torchrl.objectives import SACLoss, SoftUpdate

from dune_rl.learning.layout import Layout
from dune_rl.learning.networks import FEATURES, Architecture, Features, make_action_value, make_policy
from dune_rl.learning.replay import Transitions
from dune_rl.settings import Settings

Width = Annotated[int, Field(ge=1, le=8192)]


class SacConf(Settings):
    """Hyperparameters; the defaults are the paper's where it states them."""

    learning_rate: float = Field(3e-4, gt=0, description="at frame 0")
    final_learning_rate: float = Field(5e-5, gt=0, description="at total_frames, reached linearly")
    entropy_learning_rate: float = Field(
        3e-3, gt=0, description="of the entropy coefficient, falling in step with the other"
    )
    learning_starts: int = Field(50_000, ge=0, description="frames before the first update")
    warm_up: Literal["random", "go_to_goal"] = Field("go_to_goal", description="who acts in them")
    updates_per_frame: float = Field(0.0625, gt=0, description="gradient updates for each frame collected")
    batch_size: int = Field(512, ge=1)
    hidden: tuple[Width, ...] = Field((256, 256), min_length=1)
    scan_channels: int = Field(8, ge=0, le=1024, description="of the convolutions round the scans; 0: none")
    image_channels: tuple[Width, ...] = Field(
        (16, 32, 32), min_length=1, description="of the convolutions over each image, if there are any"
    )
    image_features: int = Field(64, ge=1, le=4096, description="values that each image is reduced to")
    gamma: float = Field(0.99, ge=0, lt=1)
    n_steps: int = Field(8, ge=1, le=64, description="of reward before the bootstrap; 1 is plain SAC")
    tau: float = Field(0.005, gt=0, le=0.5, description="share of the new weights in each target update")
    initial_entropy_coefficient: float = Field(0.5, gt=0)
    target_entropy: float | None = Field(
        None, description="nats, for actions scaled to [-1, 1]; null: minus the number of action components"
    )
    reward_scale: float = Field(1.0, gt=0, description="multiplies the reward in the loss, never in the logs")
    observation_clip: float = Field(10.0, gt=0, description="bound on normalised observations")
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="of the networks' products; auto: bfloat16 where the processor has it built in"
    )
    threads: int | None = Field(
        None, ge=1, description="of the learner; null: 1 if serial, else the cores left over, up to 4"
    )

    @property
    def architecture(self) -> Architecture:
        """Those of the settings that shape the networks."""
        return Architecture(
            self.hidden, self.scan_channels, self.observation_clip, self.image_channels, self.image_features
        )


def has_bfloat16(device: torch.device) -> bool:
    """Whether `device` multiplies bfloat16 matrices itself, which halves the time of an update."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))


class Sac:
    """Policy, twin action values and their optimiser, for one `Layout`.

    `policy` maps an environment's output to "action". Its normaliser is
    updated only by `observe`, from collected data, and is no part of the loss;
    its scan encoder serves the critics too.
    """

    def __init__(self, conf: SacConf, layout: Layout, total_frames: int, device: torch.device | str = "cpu"):
        self._conf = conf
        self._total_frames = total_frames
        self._device = torch.device(device)
        self._reduced = conf.precision == "bfloat16" or (
            conf.precision == "auto" and has_bfloat16(self._device)
        )
        self.transitions = Transitions(layout, conf.n_steps, conf.gamma)
        self.policy = make_policy(layout, conf.architecture, device)
        self.features: Features = self.policy[0].module
        # The loss wants the entropy of actions in physical units, which the scaling shifts.
        entropy = -float(layout.action_size) if conf.target_entropy is None else conf.target_entropy
        self._loss = SACLoss(
            self.policy[1],
            make_action_value(layout, self.features.size, conf.hidden, device),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=conf.initial_entropy_coefficient,
            target_entropy=entropy + float(layout.half_range.log().sum()),
            delay_qvalue=True,
        )
        self._loss.make_value_estimator(gamma=conf.gamma)
        # Lazily made by SACLoss otherwise, which would leave it out of a fresh state_dict.
        self._target_entropy = self._loss.target_entropy
        self._loss.to(device)
        self._target_update = SoftUpdate(self._loss, tau=conf.tau)
        coefficient = self._loss.log_alpha
        networks = [p for p in self._loss.parameters() if p.requires_grad and p is not coefficient]
        networks += self.features.parameters()
        self._optimiser = torch.optim.Adam(
            [
                {"params": networks, "lr": conf.learning_rate},
                {"params": [coefficient], "lr": conf.entropy_learning_rate},
            ],
            fused=True,
        )

    def observe(self, rows: Tensor) -> None:
        """Let the normaliser see newly collected `rows`, once, before they are learnt from."""
        self.features.normaliser.observe(self.transitions.vectors(rows).to(self._device))

    def schedule(self, frames: int) -> float:
        """Set and give the learning rate that is due after `frames`."""
        share = min(1.0, frames / self._total_frames)
        rate = self._conf.learning_rate + share * (self._conf.final_learning_rate - self._conf.learning_rate)
        networks, coefficient = self._optimiser.param_groups
        networks["lr"] = rate
        coefficient["lr"] = self._conf.entropy_learning_rate * rate / self._conf.learning_rate
        return rate

    def learn(self, minibatches: Iterable[Tensor]) -> dict[str, float]:
        """One update for each of `minibatches` (b, width); mean losses, entropy coefficient and entropy."""
        totals: dict[str, Tensor] = {}
        count = 0
        for rows in minibatches:
            for key, value in self._update(rows).items():
                totals[key] = totals[key] + value if key in totals else value
            count += 1
        return {key: float(value) / count for key, value in totals.items()}

    def _update(self, rows: Tensor) -> dict[str, Tensor]:
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._reduced):
            batch = self.transitions.batch(rows, self.features.encode, self._conf.reward_scale)
            features = batch.get(FEATURES)
            # The encoder learns from the critics alone, as in Yarats et al. (2021): it is cut off
            # here, and given the gradient of their loss before the actor's adds its own.
            cut = features.detach().requires_grad_()
            losses = self._loss(batch.set(FEATURES, cut))
        losses["loss_qvalue"].backward()
        if features.requires_grad:
            features.backward(cut.grad)
        (losses["loss_actor"] + losses["loss_alpha"]).backward()
        self._optimiser.step()
        self._optimiser.zero_grad()
        self._target_update.step()
        return {
            "loss/actor": losses["loss_actor"].detach(),
            "loss/critic": losses["loss_qvalue"].detach(),
            "loss/alpha": losses["loss_alpha"].detach(),
            "sac/alpha": losses["alpha"].detach(),
            "sac/entropy": losses["entropy"].detach(),
        }

    def state_dict(self) -> dict[str, Any]:
        """Everything that learning has changed, in plain containers of tensors."""
        # The loss's dictionary holds batch sizes beside its tensors; those follow from the settings.
        loss = self._loss.state_dict()
        return {
            "policy": dict(self.policy.state_dict()),
            "loss": {key: value for key, value in loss.items() if isinstance(value, Tensor)},
            "optimiser": self._optimiser.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The inverse of `state_dict`."""
        self.policy.load_state_dict(state["policy"])
        current = self._loss.state_dict()
        self._loss.load_state_dict({**current, **state["loss"]})
        self._optimiser.load_state_dict(state["optimiser"])
