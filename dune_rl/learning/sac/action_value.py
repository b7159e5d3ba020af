"""The action value Q of soft actor-critic."""

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from dune_rl.learning.networks.perceptron import perceptron
from dune_rl.learning.networks.policy import FEATURES
from dune_rl.learning.policy_spec import PolicySpec


class ActionValue(nn.Module):
    """Q(features, action), (..., 1), for actions in physical units, which it scales to [-1, 1]."""

    middle: Tensor
    half_range: Tensor

    def __init__(self, spec: PolicySpec, features: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.body = perceptron(features + spec.action_size, hidden, 1)
        self.register_buffer("middle", spec.middle)
        self.register_buffer("half_range", spec.half_range)

    def forward(self, features: Tensor, action: Tensor) -> Tensor:
        """In float32 also under autocast: targets are differences of large values."""
        scaled = (action - self.middle) / self.half_range
        return self.body(torch.cat([features, scaled], -1)).float()


def make_action_value(
    spec: PolicySpec, features: int, hidden: Sequence[int], device: torch.device | str = "cpu"
) -> TensorDictModule:
    """From `features` features and the action to "state_action_value"."""
    return TensorDictModule(
        ActionValue(spec, features, hidden), in_keys=[FEATURES, "action"], out_keys=["state_action_value"]
    ).to(device)
