"""The policy network: features of the observation, then a tanh-normal over the action's bounds."""

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from dune_rl.learning.networks.features import Architecture, Features
from dune_rl.learning.policy_spec import PolicySpec

FEATURES = "features"
_LOG_SCALE_MIN, _LOG_SCALE_MAX = -5.0, 2.0


def perceptron(n_in: int, hidden: Sequence[int], n_out: int) -> nn.Sequential:
    """Linear layers with a ReLU after each but the last."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(n_in, width), nn.ReLU()]
        n_in = width
    return nn.Sequential(*layers, nn.Linear(n_in, n_out))


class Actor(nn.Module):
    """Location and scale of the action before its tanh, each (..., A), from features."""

    def __init__(self, spec: PolicySpec, features: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.body = perceptron(features, hidden, 2 * spec.action_size)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """In float32 also under autocast: the log-probability of a squashed action needs it."""
        loc, raw = self.body(features).float().chunk(2, -1)
        share = (torch.tanh(raw) + 1) / 2
        return loc, torch.exp(_LOG_SCALE_MIN + (_LOG_SCALE_MAX - _LOG_SCALE_MIN) * share)


def make_policy_network(
    spec: PolicySpec, architecture: Architecture, device: torch.device | str = "cpu"
) -> TensorDictSequential:
    """From the observation's parts to "action": features, then a tanh-normal over the action's bounds.

    Its first module holds the normaliser and the encoder, its second is the actor that a loss takes.
    """
    features = Features(spec, architecture)
    actor = ProbabilisticActor(
        module=TensorDictModule(
            Actor(spec, features.size, architecture.hidden), in_keys=[FEATURES], out_keys=["loc", "scale"]
        ),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={
            "low": torch.tensor(spec.low, device=device),
            "high": torch.tensor(spec.high, device=device),
        },
    )
    encoder = TensorDictModule(features, in_keys=spec.keys, out_keys=[FEATURES])
    return TensorDictSequential(encoder, actor).to(device)
