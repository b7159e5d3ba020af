"""One gradient step of soft actor-critic: action values, losses, optimiser and target networks."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.objectives import CrossQLoss, DiscreteSACLoss, SACLoss, SoftUpdate

from dune_rl.learning.networks.critic import CRITIC_FEATURES, CriticFeatures
from dune_rl.learning.networks.policy import FEATURES, Features, perceptron
from dune_rl.learning.optimiser import FiniteAdam
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec
from dune_rl.learning.sac.settings import MaximumEntropyConf, SacConf

MakeBatch = Callable[[Callable[[PackedObservation], Tensor]], TensorDict]


class GradientStep:
    """Twin action values, their targets, the entropy coefficient, and the optimiser of these and of a policy.

    The normaliser of the policy's features is no part of the loss; their encoder serves the critics too.
    """

    # Of Adam: PyTorch's own.
    _betas = (0.9, 0.999)

    def __init__(
        self,
        conf: MaximumEntropyConf,
        spec: PolicySpec,
        network: TensorDictSequential,
        critic_features: CriticFeatures,
        device: torch.device,
    ) -> None:
        self._conf = conf
        self._device = device
        self._reduced = conf.resolved(str(device)).precision == "bfloat16"
        self._features: Features = network[0].module
        self._critic_features = critic_features
        size = self._features.size + critic_features.size
        key = CRITIC_FEATURES if critic_features.size else FEATURES
        self.loss = self._make_loss(network[1], spec, size, key)
        self.loss.make_value_estimator(gamma=conf.gamma)
        # Lazily made by SACLoss otherwise, which would leave it out of a fresh state_dict.
        self._target_entropy = self.loss.target_entropy
        self.loss.to(device)
        coefficient = self.loss.log_alpha
        networks = [p for p in self.loss.parameters() if p.requires_grad and p is not coefficient]
        networks += [*self._features.parameters(), *critic_features.parameters()]
        self.optimiser = FiniteAdam(
            [
                {"params": networks, "lr": conf.learning_rate},
                {"params": [coefficient], "lr": conf.entropy_learning_rate},
            ],
            betas=self._betas,
        )

    def _make_loss(
        self, actor: ProbabilisticTensorDictSequential, spec: PolicySpec, features: int, key: str
    ) -> SACLoss | CrossQLoss | DiscreteSACLoss:
        """The loss of the actor, and of critics that read `features` features under `key`."""
        conf = self._conf
        assert isinstance(conf, SacConf)
        loss = _TwinCriticLoss(
            actor,
            make_action_value(spec, features, conf.hidden, self._device, key),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=conf.initial_entropy_coefficient,
            target_entropy=self._target_entropy_of(spec),
            delay_qvalue=True,
        )
        self._target_update = SoftUpdate(loss, tau=conf.tau)
        return loss

    def _target_entropy_of(self, spec: PolicySpec) -> float:
        """The target as the loss wants it: of actions in physical units, which the scaling shifts."""
        wanted = self._conf.target_entropy
        entropy = -float(spec.action_size) if wanted is None else wanted
        return entropy + float(spec.half_range.log().sum())

    def _update_targets(self) -> None:
        self._target_update.step()

    def schedule(self, share: float) -> float:
        """Set and return the learning rate that is due after a `share` (0 to 1) of the run."""
        conf = self._conf
        rate = conf.learning_rate_at(share)
        networks, coefficient = self.optimiser.param_groups
        networks["lr"] = rate
        coefficient["lr"] = conf.entropy_learning_rate * rate / conf.learning_rate
        return rate

    def __call__(self, make_batch: MakeBatch) -> dict[str, Tensor]:
        """Take one step; `make_batch` makes the loss's input with the features that it is given.

        Returns the losses, the entropy coefficient and the entropy, without gradients.
        """
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._reduced):
            batch = make_batch(self._encode)
            features = batch.get(FEATURES)
            # The encoder learns from the critics alone, as in Yarats et al. (2021): it is cut off
            # here, and given the gradient of their loss before the actor's adds its own.
            cut = features.detach().requires_grad_()
            losses = self.loss(self._separate(batch.set(FEATURES, cut)))
        losses["loss_qvalue"].backward()
        if features.requires_grad and self._trains_encoder:
            features.backward(cut.grad)
        if self._trains_actor:
            (losses["loss_actor"] + losses["loss_alpha"]).backward()
        self.optimiser.step()
        self.optimiser.zero_grad()
        self._update_targets()
        return {
            "loss/actor": losses["loss_actor"].detach(),
            "loss/critic": losses["loss_qvalue"].detach(),
            "loss/alpha": losses["loss_alpha"].detach(),
            "sac/alpha": losses["alpha"].detach(),
            "sac/entropy": losses["entropy"].detach(),
        }

    @property
    def _trains_actor(self) -> bool:
        """Whether the policy learns, or the critics alone."""
        return True

    @property
    def _trains_encoder(self) -> bool:
        return self._trains_actor

    def _encode(self, packed: PackedObservation) -> Tensor:
        """Features (k, n) of observations, for all networks."""
        return self._critic_features.encode(packed)

    def _separate(self, batch: TensorDict) -> TensorDict:
        """The features of actor and critics each under its own key, where they differ."""
        if self._critic_features.size:
            for part in (batch, batch.get("next")):
                features = part.get(FEATURES)
                part.set(CRITIC_FEATURES, features).set(FEATURES, features[..., : self._features.size])
        return batch

    @torch.no_grad()
    def action_values(self, make_batch: MakeBatch) -> Tensor:
        """The smaller of both action values (k,) of the transitions of `make_batch`, on the CPU."""
        batch = self._separate(make_batch(self._encode))
        return self._evaluate_critics(batch).amin(0).squeeze(-1).float().cpu()

    def _evaluate_critics(self, batch: TensorDict) -> Tensor:
        """The action values (n, k, 1) of n critics."""
        found: Tensor = evaluate_critics(batch, self.loss.qvalue_network_params)["state_action_value"]
        return found

    def state_dict(self) -> dict[str, Any]:
        """Parameters of the loss, targets included, and the optimiser's state."""
        # The loss's dictionary holds batch sizes beside its tensors; those follow from the settings.
        loss = self.loss.state_dict()
        return {
            "loss": {key: value for key, value in loss.items() if isinstance(value, Tensor)},
            "privileged": self._critic_features.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }

    def load_weights(self, state: Mapping[str, Any]) -> None:
        """Take the parameters of the loss, targets included, and of the critics' encoders, from `state`."""
        # What the coefficient adapts to follows from the settings, which may have changed.
        loss = {name: value for name, value in state["loss"].items() if name != "target_entropy"}
        self.loss.load_state_dict({**self.loss.state_dict(), **loss})
        # Runs from before there were privileged sensors have none.
        self._critic_features.load_state_dict(state.get("privileged", {}))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.load_weights(state)
        self.optimiser.load_state_dict(state["optimiser"])


class _TwinCriticLoss(SACLoss):
    """TorchRL's loss, with the critics evaluated by batched products.

    The loss calls them three times, and the dispatch of `vmap` takes a third of an update in bfloat16.
    """

    def _make_vmap(self) -> None:
        self._vmap_qnetworkN0 = evaluate_critics


class ActionValue(nn.Module):
    """Q(features, action), (..., 1), for actions in physical units, which it scales to [-1, 1]."""

    middle: Tensor
    half_range: Tensor

    def __init__(
        self,
        spec: PolicySpec,
        features: int,
        hidden: Sequence[int],
        norm: Callable[[int], nn.Module] | None = None,
    ) -> None:
        super().__init__()
        self.body = perceptron(features + spec.action_size, hidden, 1, norm)
        self.register_buffer("middle", spec.middle)
        self.register_buffer("half_range", spec.half_range)

    def forward(self, features: Tensor, action: Tensor) -> Tensor:
        """In float32 also under autocast: targets are differences of large values."""
        scaled = (action - self.middle) / self.half_range
        return self.body(torch.cat([features, scaled], -1)).float()


def make_action_value(
    spec: PolicySpec,
    features: int,
    hidden: Sequence[int],
    device: torch.device | str = "cpu",
    key: str = FEATURES,
    norm: Callable[[int], nn.Module] | None = None,
) -> TensorDictModule:
    """From the `features` features under `key`, and the action, to "state_action_value"."""
    return TensorDictModule(
        ActionValue(spec, features, hidden, norm), in_keys=[key, "action"], out_keys=["state_action_value"]
    ).to(device)


def evaluate_critics(batch: TensorDictBase, parameters: TensorDictBase) -> TensorDict:
    """The "state_action_value" (n, k, 1) of a batch (k,) by n critics at once, as each `ActionValue` has it.

    `parameters` are those of the modules of `make_action_value`, stacked.
    """
    own = parameters["module"]
    scaled = (batch["action"] - own["middle"][0]) / own["half_range"][0]
    features = batch.get(CRITIC_FEATURES, batch.get(FEATURES, None))
    values = torch.cat([features, scaled], -1).expand(*own.batch_size, -1, -1)
    layers = [own["body", number] for number in sorted(own["body"].keys(), key=int)]
    for number, layer in enumerate(layers):
        values = torch.relu(values) if number else values
        values = torch.baddbmm(layer["bias"].unsqueeze(1), values, layer["weight"].transpose(1, 2))
    return TensorDict({"state_action_value": values.float()}, values.shape[:2])
