"""Discrete soft actor-critic as a learner of one agent group: the values of all commands at once."""

import copy
import math
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import DiscreteSACLoss, SoftUpdate

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.discrete_sac.settings import DiscreteSacConf
from dune_rl.learning.networks.commands import CommandHead, check_prior, make_command_network
from dune_rl.learning.networks.policy import FEATURES, perceptron
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec
from dune_rl.learning.sac.gradient_step import GradientStep, MakeBatch
from dune_rl.learning.sac.learner import MaximumEntropyLearner

_ENTROPY_SHARE = 0.25
# Of their random weights that critics keep which begin by an imitated policy's costs, or by a prior's.
_RANDOM_SHARE = 0.1
# Log probabilities (..., C) of the commands by the policy from which a divergence is measured.
_REFERENCE = "reference"


class DiscreteSacStep(GradientStep):
    """A gradient step with critics that give the values of all commands."""

    _conf: DiscreteSacConf

    def _make_loss(
        self, actor: TensorDictModule, spec: PolicySpec, features: int, key: str
    ) -> DiscreteSACLoss:
        conf, head = self._conf, actor.module
        assert isinstance(head, CommandHead)
        self._commands, self._head = head.commands, head
        self._taken = 0
        self._reference: TensorDictSequential | None = None
        self._set_temperature(head)
        values = TensorDictModule(
            _CommandValues(features, conf, head),
            in_keys=[key],
            out_keys=["action_value"],
        ).to(self._device)
        make_loss = DiscreteSACLoss if conf.target_divergence is None else _DivergenceLoss
        loss = make_loss(
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
        if self._conf.target_divergence is not None:
            return -self._conf.target_divergence
        wanted = self._conf.target_entropy
        return _ENTROPY_SHARE * math.log(len(self._commands)) if wanted is None else wanted

    def _separate(self, batch: TensorDict) -> TensorDict:
        """Also the number of the command that is nearest to each action."""
        apart = (batch.get("action")[:, None] - self._commands).square().sum(-1)
        batch.set("action", apart.argmin(-1))
        if self._conf.target_divergence is not None:
            for part in (batch, batch.get("next")):
                features = part.get(FEATURES)
                split = features.shape[-1] - len(self._commands)
                part.set(_REFERENCE, features[..., split:]).set(FEATURES, features[..., :split])
        return super()._separate(batch)

    def _encode(self, packed: PackedObservation) -> Tensor:
        """What actor and critics read, and behind it the log probabilities of the reference."""
        own = super()._encode(packed)
        if self._conf.target_divergence is None:
            return own
        with torch.no_grad():
            if self._reference is None:
                logits = self._head.prior_logits(own)
            else:
                features, head = (module.module for module in self._reference)
                public = self._critic_features.select_public(packed)
                logits = head.predict(features.encode(public))[0]
        return torch.cat([own, logits.log_softmax(-1)], -1)

    def measure_divergence_from(self, network: TensorDictSequential) -> None:
        """Take a copy of `network` for the policy from which the divergence is measured, not the prior's."""
        self._reference = copy.deepcopy(network).requires_grad_(requires_grad=False)

    def __call__(self, make_batch: MakeBatch) -> dict[str, Tensor]:
        """As the base, with "sac/divergence" in place of "sac/entropy" where there is a target of it."""
        self._taken += 1
        found = super().__call__(make_batch)
        if self._conf.target_divergence is not None:
            found["sac/divergence"] = -found.pop("sac/entropy")
        return found

    @property
    def _trains_actor(self) -> bool:
        return self._taken > self._conf.critic_updates

    @property
    def _trains_encoder(self) -> bool:
        """Also while a new policy is its prior, which reads nothing of what the encoder makes."""
        is_prior = self._conf.prior is not None and self._conf.start_from is None
        return self._trains_actor or is_prior

    def _set_temperature(self, head: CommandHead) -> None:
        """Let the logits of a prior be those of the best policy by its costs, at the initial coefficient."""
        if self._conf.prior is not None:
            head.temperature.fill_(self._conf.initial_entropy_coefficient / self._conf.reward_scale)

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
        self._set_temperature(head)
        layers[-1].weight[: len(weight)] = weight / coefficient
        layers[-1].bias[: len(bias)] = bias / coefficient

    def _evaluate_critics(self, batch: TensorDict) -> Tensor:
        values = self.loss._vmap_qnetworkN0(batch.clone(recurse=False), self.loss.qvalue_network_params)
        action = batch.get("action").expand(2, -1).unsqueeze(-1)
        found: Tensor = values.get("action_value").gather(-1, action)
        return found

    def state_dict(self) -> dict[str, Any]:
        reference = {} if self._reference is None else {_REFERENCE: self._reference.state_dict()}
        return {**super().state_dict(), "taken": self._taken, **reference}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self._taken = state["taken"]
        if self._reference is not None:
            if _REFERENCE not in state:
                raise CheckpointError(
                    "the run began without learning.target_divergence, and knows no policy to measure it "
                    "from: leave it out, or begin a new run with learning.start_from"
                )
            self._reference.load_state_dict(state[_REFERENCE])


class _DivergenceLoss(DiscreteSACLoss):
    """The loss with the divergence from a reference policy in place of the entropy.

    Its "entropy" is the negative divergence (Kullback and Leibler's): the policy is the best one by the
    critics' values that is, on average, no farther from the reference than the target.
    """

    def _policy(self, batch: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Probabilities (k, C) of the commands, and the logarithms of their ratios to the reference's."""
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            distribution = self.actor_network.get_dist(batch.clone(recurse=False))
        return distribution.probs, distribution.logits - batch.get(_REFERENCE)

    def _value(self, batch: TensorDictBase, parameters: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Expected value (k,) of the policy, less the price of its divergence, and the divergence (k,)."""
        probability, ratio = self._policy(batch)
        read = batch.select(*self.qvalue_network.in_keys)
        values = self._vmap_qnetworkN0(read, parameters).get("action_value").amin(0)
        return (probability * (values - self._alpha * ratio)).sum(-1), (probability * ratio).sum(-1)

    @torch.no_grad()
    def _compute_target(self, tensordict: TensorDictBase) -> Tensor:
        value, _ = self._value(tensordict.get("next"), self.target_qvalue_network_params)
        copied = tensordict.copy()
        copied.set(("next", self.value_estimator.tensor_keys.value), value.unsqueeze(-1))
        target: Tensor = self.value_estimator.value_estimate(copied).squeeze(-1)
        return target

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        value, divergence = self._value(tensordict, self._cached_detached_qvalue_params)
        return -value.mean(), {"log_prob": divergence.detach()}


class _CommandValues(nn.Module):
    """Values (..., C) of all commands, in float32 also under autocast.

    To those of the network the negative costs of the policy's prior are added, if it has one from which no
    divergence is measured: costs of a look ahead differ by more than values, whose next commands are free.
    """

    prior_scale: Tensor

    def __init__(self, features: int, conf: DiscreteSacConf, head: CommandHead) -> None:
        super().__init__()
        self.body = perceptron(features, conf.hidden, len(head.commands))
        adds_prior = conf.target_divergence is None or conf.start_from is not None
        scale = conf.reward_scale * (1.0 + head.prior_weight) if adds_prior else 0.0
        # It goes along with the weights, which were trained with it.
        self.register_buffer("prior_scale", torch.tensor(scale))
        # The policy's own, whose weights are no part of the critics.
        self._of_policy = (head,)
        if conf.prior is not None and conf.start_from is None and adds_prior:
            _shrink(self.body[-1])

    def forward(self, features: Tensor) -> Tensor:
        (head,) = self._of_policy
        values: Tensor = self.body(features).float()
        return values - self.prior_scale * head.guess(features)


class _Logits(nn.Module):
    """The logits (..., C) of a head, whose weights it shares."""

    def __init__(self, head: CommandHead) -> None:
        super().__init__()
        self.body = head.body
        self._head = (head,)

    def forward(self, features: Tensor) -> Tensor:
        (head,) = self._head
        logits: Tensor = head.predict(features)[0]
        return logits


@torch.no_grad()
def _shrink(layer: nn.Module) -> None:
    """Let a layer begin with about nothing, and not with the same in two networks."""
    assert isinstance(layer, nn.Linear)
    layer.weight.mul_(_RANDOM_SHARE)
    layer.bias.mul_(_RANDOM_SHARE)


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
        if conf.target_divergence is not None:
            if conf.target_entropy is not None:
                raise ConfigError(
                    "learning.target_entropy and learning.target_divergence are two targets of one "
                    "coefficient: leave one of them null"
                )
            if conf.start_from is None and conf.prior is None:
                raise ConfigError(
                    "learning.target_divergence is measured from the policy of learning.start_from, or from "
                    "learning.prior: name a run's folder or a policy's file, or a prior, or leave "
                    "target_divergence null"
                )
            self._measure_divergence()

    def _measure_divergence(self) -> None:
        if self._conf.target_divergence is not None and self._conf.start_from is not None:
            assert isinstance(self._step, DiscreteSacStep)
            self._step.measure_divergence_from(self.policy.network)

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the policy, and with its critics, or by the costs of an imitated policy."""
        super().start_from(saved)
        if self._is_imitated(saved):
            assert isinstance(self._step, DiscreteSacStep)
            self._step.begin_by_costs(self.policy.network[1].module)
        self._measure_divergence()

    def has_new_critics(self, entry: Mapping[str, Any]) -> bool:
        return super().has_new_critics(entry) and not self._is_imitated(entry)

    def _is_imitated(self, saved: Mapping[str, Any]) -> bool:
        # A policy's entry tells its algorithm; the state of a learner does not.
        return "loss" not in saved and saved.get("algorithm", "imitation") in self.starts_from

    def check_environment(self, env: EnvBase) -> None:
        """Raise ConfigError where a driver cannot demonstrate, or the prior has other commands."""
        super().check_environment(env)
        check_prior(self._conf, env, self.context.group)

    def network_settings(self) -> dict[str, Any]:
        return {**super().network_settings(), **self._conf.plain_commands()}

    @classmethod
    def make_network(
        cls, spec: PolicySpec, settings: Mapping[str, Any], device: torch.device | str = "cpu"
    ) -> TensorDictModuleBase:
        return make_command_network(spec, settings, device, draws=True)
