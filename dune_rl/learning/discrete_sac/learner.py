"""Discrete soft actor-critic as a learner of one agent group: the values of all commands at once."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import DiscreteSACLoss, SoftUpdate

from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.discrete_sac.settings import DiscreteSacConf
from dune_rl.learning.networks.commands import CommandHead, make_command_network
from dune_rl.learning.networks.policy import FEATURES, perceptron
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.sac.gradient_step import GradientStep, MakeBatch
from dune_rl.learning.sac.learner import MaximumEntropyLearner

_ENTROPY_SHARE = 0.25
# Of their random weights that critics keep which begin by an imitated policy's costs.
_RANDOM_SHARE = 0.1


class DiscreteSacStep(GradientStep):
    """A gradient step with critics that give the values of all commands."""

    _conf: DiscreteSacConf

    def _make_loss(
        self, actor: TensorDictModule, spec: PolicySpec, features: int, key: str
    ) -> DiscreteSACLoss:
        conf, head = self._conf, actor.module
        assert isinstance(head, CommandHead)
        self._commands = head.commands
        self._taken = 0
        values = TensorDictModule(
            _CommandValues(features, conf.hidden, len(head.commands)),
            in_keys=[key],
            out_keys=["action_value"],
        ).to(self._device)
        loss = DiscreteSACLoss(
            _categorical(head),
            values,
            action_space="categorical",
            num_actions=len(head.commands),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=conf.initial_entropy_coefficient,
            target_entropy=self._target_entropy_of(spec),
            delay_qvalue=True,
        )
        self._target_update = SoftUpdate(loss, tau=conf.tau)
        return loss

    def _target_entropy_of(self, spec: PolicySpec) -> float:
        wanted = self._conf.target_entropy
        return _ENTROPY_SHARE * math.log(len(self._commands)) if wanted is None else wanted

    def _separate(self, batch: TensorDict) -> TensorDict:
        """Also the number of the command that is nearest to each action."""
        apart = (batch.get("action")[:, None] - self._commands).square().sum(-1)
        return super()._separate(batch.set("action", apart.argmin(-1)))

    def __call__(self, make_batch: MakeBatch) -> dict[str, Tensor]:
        self._taken += 1
        return super().__call__(make_batch)

    @property
    def _trains_actor(self) -> bool:
        return self._taken > self._conf.critic_updates

    @torch.no_grad()
    def begin_by_costs(self, head: CommandHead) -> None:
        """Make the negative costs of an imitated `head` the critics' values, and its logits by these.

        The logits are those of the best policy by such values at the initial entropy coefficient. The critics
        keep a share of their random weights, without which the two would stay equal.
        """
        layers = [layer for layer in head.body if isinstance(layer, nn.Linear)]
        of_costs: list[tuple[Tensor, Tensor]] = [(layer.weight, layer.bias) for layer in layers[:-1]]
        _, weight = layers[-1].weight.chunk(2)
        _, bias = layers[-1].bias.chunk(2)
        scale = -self._conf.reward_scale
        of_costs.append((scale * weight, scale * bias))
        critics = self.loss.qvalue_network_params["module", "body"]
        targets = self.loss.target_qvalue_network_params["module", "body"]
        for name, (weight, bias) in zip(sorted(critics.keys(), key=int), of_costs, strict=True):
            critic, target = critics[name], targets[name]
            critic["weight"].data.mul_(_RANDOM_SHARE)[..., : weight.shape[1]].add_(weight)
            critic["bias"].data.mul_(_RANDOM_SHARE).add_(bias)
            target["weight"].data.copy_(critic["weight"].data)
            target["bias"].data.copy_(critic["bias"].data)
        weight, bias = of_costs[-1]
        coefficient = self._conf.initial_entropy_coefficient
        layers[-1].weight[: len(weight)] = weight / coefficient
        layers[-1].bias[: len(bias)] = bias / coefficient

    def _evaluate_critics(self, batch: TensorDict) -> Tensor:
        values = self.loss._vmap_qnetworkN0(batch.clone(recurse=False), self.loss.qvalue_network_params)
        action = batch.get("action").expand(2, -1).unsqueeze(-1)
        found: Tensor = values.get("action_value").gather(-1, action)
        return found

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "taken": self._taken}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self._taken = state["taken"]


class _CommandValues(nn.Module):
    """Values (..., C) of all commands, in float32 also under autocast."""

    def __init__(self, features: int, hidden: tuple[int, ...], commands: int) -> None:
        super().__init__()
        self.body = perceptron(features, hidden, commands)

    def forward(self, features: Tensor) -> Tensor:
        values: Tensor = self.body(features).float()
        return values


class _Logits(nn.Module):
    """The logits (..., C) of a head, whose weights it shares."""

    def __init__(self, head: CommandHead) -> None:
        super().__init__()
        self.body = head.body

    def forward(self, features: Tensor) -> Tensor:
        logits, _ = self.body(features).float().chunk(2, -1)
        return logits


def _categorical(head: CommandHead) -> ProbabilisticTensorDictSequential:
    return ProbabilisticActor(
        TensorDictModule(_Logits(head), in_keys=[FEATURES], out_keys=["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
    )


class DiscreteSac(MaximumEntropyLearner):
    """Discrete soft actor-critic (Christodoulou 2019) on the network, and from the weights, of `imitation`.

    The policy draws a command by the logits, and takes the likeliest one where it is evaluated. Raises
    ConfigError for an action that is no speed and heading.
    """

    _conf: DiscreteSacConf
    step_class = DiscreteSacStep
    starts_from = ("imitation",)

    def __init__(self, context: LearnerContext, conf: DiscreteSacConf) -> None:
        super().__init__(context, conf)

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the policy, and with its critics, or by the costs of an imitated policy."""
        super().start_from(saved)
        if self._is_imitated(saved):
            assert isinstance(self._step, DiscreteSacStep)
            self._step.begin_by_costs(self.policy.network[1].module)

    def has_new_critics(self, entry: Mapping[str, Any]) -> bool:
        return super().has_new_critics(entry) and not self._is_imitated(entry)

    def _is_imitated(self, saved: Mapping[str, Any]) -> bool:
        # A policy's entry tells its algorithm; the state of a learner does not.
        return "loss" not in saved and saved.get("algorithm", "imitation") in self.starts_from

    def network_settings(self) -> dict[str, Any]:
        return {**super().network_settings(), "commands": self._conf.commands.model_dump()}

    @classmethod
    def make_network(
        cls, spec: PolicySpec, settings: Mapping[str, Any], device: torch.device | str = "cpu"
    ) -> TensorDictModuleBase:
        return make_command_network(spec, settings, device, draws=True)
