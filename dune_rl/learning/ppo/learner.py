"""Proximal policy optimisation as a learner of one agent group."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import GRUModule, set_recurrent_mode
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from dune_rl.learning.algorithm import Algorithm, LearnerContext, mean_values
from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.critic import (
    CRITIC_FEATURES,
    CriticFeatures,
    Value,
    split_encoders,
)
from dune_rl.learning.networks.policy import (
    BEGINS,
    FEATURES,
    MEMORY,
    Architecture,
    Features,
)
from dune_rl.learning.optimiser import FiniteAdam
from dune_rl.learning.policy_spec import PackedObservation
from dune_rl.learning.ppo.settings import PpoConf

_VALUE = "state_value"
# TorchRL's losses leave out the entries for which it is false.
_VALID = "shifted_valid"


class Ppo(Algorithm):
    """Clipped PPO with one policy and one critic for all agents of a group.

    The normaliser is updated after a batch has been learned from, so that the policy's probabilities are
    those that the batch was collected with; the first batch serves the normaliser alone.
    """

    def __init__(self, context: LearnerContext, conf: PpoConf) -> None:
        self._conf = conf
        spec, whole = context.spec, context.whole_spec
        architecture = replace(Architecture.of(conf), recurrent=conf.recurrent)
        self.architecture, privileged = split_encoders(architecture, spec, whole)
        super().__init__(context)
        network = self.policy.network
        self._actor = network[-1]
        self._actor[0].module.set_noise(conf.initial_scale)
        self._features: Features = network[0].module
        # A GRU's first layer is its only one, so that what it gives is what it remembers.
        self._memory: GRUModule | None = network[1] if conf.recurrent else None
        self._critic_features = CriticFeatures(self._features, spec, whole, privileged).to(context.device)
        size = (conf.recurrent or self._features.size) + self._critic_features.size
        self._critic = Value(size, conf.hidden, context.num_agents if conf.central_critic else 1)
        self._critic.to(context.device)
        self.loss = ClipPPOLoss(
            self._actor,
            TensorDictModule(self._critic, in_keys=[CRITIC_FEATURES], out_keys=[_VALUE]),
            clip_epsilon=conf.clip,
            entropy_coeff=conf.entropy_coefficient,
            critic_coeff=conf.critic_coefficient,
            loss_critic_type="l2",
            normalize_advantage=True,
        ).to(context.device)
        self._advantage = GAE(
            gamma=conf.gamma, lmbda=conf.gae_lambda, value_network=None, device=context.device
        )
        self._parameters = [
            parameter
            for module in (self.loss, self._features, self._memory, self._critic_features)
            for parameter in (() if module is None else module.parameters())
            if parameter.requires_grad
        ]
        self.optimiser: FiniteAdam = FiniteAdam(self._parameters, lr=conf.learning_rate)
        self._batch: TensorDict | None = None
        self._frames = 0

    def make_policy(self, device: torch.device | str = "cpu") -> GroupPolicy:
        """The policy writes its distribution too, from which the probabilities of its actions follow."""
        network = self.make_network(self.context.spec, self.network_settings(), device)
        return GroupPolicy(self.context.group, self.context.spec, network, ("action", "loc", "scale"))

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Keep the batch until `update`."""
        self._frames = frames
        after, spec = batch.get("next"), self.context.whole_spec
        now, later = (spec.pack(each.get("observation")) for each in (batch, after))
        kept = TensorDict(
            {
                **now._asdict(),
                **batch.select("action", "loc", "scale", MEMORY, BEGINS, strict=False).to_dict(),
                _VALID: ~batch.get("done"),
                "next": TensorDict(
                    {
                        **later._asdict(),
                        "reward": after.get("reward") * self._conf.reward_scale,
                        **after.select("done", "terminated").to_dict(),
                    },
                    batch.batch_size,
                ),
            },
            batch.batch_size,
        )
        # Agents before steps, as the advantage wants them.
        self._batch = kept.permute(0, 2, 1).contiguous().to(self.context.device)

    def update(self) -> dict[str, float]:
        """Learn from the batch in `epochs` passes; mean losses, entropy, and how far the policy moved."""
        batch, self._batch = self._batch, None
        if batch is None:
            return {}
        values: dict[str, float] = {}
        if self._features.normaliser.count > 0:
            rate = self._conf.learning_rate_at(min(1.0, self._frames / self.context.total_frames))
            self.optimiser.param_groups[0]["lr"] = rate
            values = {**self._learn(batch), "ppo/learning_rate": rate}
        valid = batch[_VALID].squeeze(-1)
        if valid.any():
            self._critic_features.observe(_packed(batch[valid]))
        return values

    def _learn(self, batch: TensorDict) -> dict[str, float]:
        self._evaluate_batch(batch)
        # Of a recurrent policy the sequences (M, G, T) of scenes, of others single steps (M * T, G).
        rows = batch if self._memory is not None else batch.permute(0, 2, 1).flatten(0, 1)
        # A piece in which all agents idle would have means over nothing.
        rows = rows[rows[_VALID].flatten(1).any(1)]
        if not len(rows):
            return {}
        pieces = max(1, min(len(rows), round(batch.numel() / self._conf.batch_size)))
        chosen = [
            part for _ in range(self._conf.epochs) for part in torch.randperm(len(rows)).tensor_split(pieces)
        ]
        means = mean_values(self._step(rows[part]) for part in chosen)
        self.updates += len(chosen)
        # The loss is in physical units of the action, which shift its entropy.
        means["ppo/entropy"] -= float(self.context.spec.half_range.log().sum())
        return means

    @torch.no_grad()
    def _evaluate_batch(self, batch: TensorDict) -> None:
        """Add the probabilities of the actions, and advantages and returns, to the batch (M, G, T)."""
        batch["action_log_prob"] = self._actor[-1].get_dist(batch).log_prob(batch["action"])
        features = self._encode(batch)
        for part, seen in ((batch, features), (batch["next"], self._encode_next(batch, features))):
            part[_VALUE] = self._critic(self._critic_features(seen, _packed(part)))
        valid = batch.pop(_VALID)
        self._advantage(batch, time_dim=2)
        batch[_VALID] = valid

    def _encode(self, rows: TensorDictBase) -> Tensor:
        """What actor and critic read in `rows`, which are sequences for a recurrent policy."""
        features = self._critic_features.encode_public(_packed(rows))
        if self._memory is None:
            return features
        with set_recurrent_mode(True):
            read = TensorDict(
                {FEATURES: features, MEMORY: rows[MEMORY], BEGINS: rows[BEGINS]}, rows.batch_size
            )
            remembered: Tensor = self._memory(read)[FEATURES]
        return remembered

    def _encode_next(self, batch: TensorDict, features: Tensor) -> Tensor:
        """The same after each step of the batch (M, G, T), before any reset, from `features` at the steps."""
        later = self._critic_features.encode_public(_packed(batch["next"]))
        if self._memory is None:
            return later
        read = TensorDict(
            {FEATURES: later, MEMORY: features.unsqueeze(-2), BEGINS: torch.zeros_like(batch[BEGINS])},
            batch.batch_size,
        )
        remembered: Tensor = self._memory(read)[FEATURES]
        return remembered

    def _step(self, rows: TensorDict) -> dict[str, Tensor]:
        """One gradient step from `rows` (n, G), or (n, G, T)."""
        features = self._encode(rows)
        rows = rows.copy().set(FEATURES, features)
        rows.set(CRITIC_FEATURES, self._critic_features(features, _packed(rows)))
        losses = self.loss(rows)
        self.optimiser.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
        norm = nn.utils.clip_grad_norm_(self._parameters, self._conf.max_gradient_norm)
        self.optimiser.step(norm=norm)
        names = {
            "loss/actor": "loss_objective",
            "loss/critic": "loss_critic",
            "ppo/entropy": "entropy",
            "ppo/clipped": "clip_fraction",
            "ppo/kl": "kl_approx",
        }
        return {**{name: losses[key].detach() for name, key in names.items()}, "ppo/gradient_norm": norm}

    def state_dict(self) -> dict[str, Any]:
        """Weights, statistics, the critic, and the optimiser's state."""
        loss = self.loss.state_dict()
        return {
            **super().state_dict(),
            "loss": {key: value for key, value in loss.items() if isinstance(value, Tensor)},
            "privileged": self._critic_features.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self._load_critic(state)
        self.optimiser.load_state_dict(state["optimiser"])

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the policy, and if it is there with the critic."""
        super().start_from(saved)
        if "loss" in saved:
            self._load_critic(saved)

    def _load_critic(self, state: Mapping[str, Any]) -> None:
        self.loss.load_state_dict({**self.loss.state_dict(), **state["loss"]})
        self._critic_features.load_state_dict(state["privileged"])


def _packed(rows: TensorDictBase) -> PackedObservation:
    return PackedObservation(rows["floats"], rows["octets"])
