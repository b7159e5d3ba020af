"""What critics read: the policy's features, and those of privileged parts of the observation."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from dune_rl.learning.networks.policy import Architecture, Features, perceptron
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec

# Where critics read other features than the policy.
CRITIC_FEATURES = "critic_features"


class CriticFeatures(nn.Module):
    """Adds features of the privileged parts of observations, packed by `whole`, to a policy's features.

    The policy reads the parts of `spec` with `features`. Without further parts in `whole` nothing is added.
    """

    def __init__(
        self, features: Features, spec: PolicySpec, whole: PolicySpec, architecture: Architecture
    ) -> None:
        super().__init__()
        hidden = [key for key in whole.keys if key not in spec.keys]
        self._spec, self._whole, self._privileged = spec, whole, whole.only(hidden)
        # The policy's own, which no critic is to change or save.
        self._of_policy = (features,)
        self.privileged = Features(self._privileged, architecture) if hidden else None
        self.size = 0 if self.privileged is None else self.privileged.size

    def select_public(self, packed: PackedObservation) -> PackedObservation:
        """The parts that the policy reads."""
        return self._whole.select(packed, self._spec)

    def encode_public(self, packed: PackedObservation) -> Tensor:
        """The policy's features (..., n) of the parts that it reads."""
        (features,) = self._of_policy
        return features.encode(self.select_public(packed))

    def encode(self, packed: PackedObservation) -> Tensor:
        """What critics read of the observations themselves, (..., n + `size`)."""
        return self(self.encode_public(packed), packed)

    def forward(self, features: Tensor, packed: PackedObservation) -> Tensor:
        """The policy's `features` (..., n) and the privileged ones behind them, (..., n + `size`)."""
        if self.privileged is None:
            return features
        hidden = self.privileged.encode(self._whole.select(packed, self._privileged))
        return torch.cat([features, hidden], -1)

    def observe(self, packed: PackedObservation) -> None:
        """Update the normalisers with observations (k,)."""
        encoders = [(self._of_policy[0], self._spec), (self.privileged, self._privileged)]
        for encoder, spec in encoders:
            if encoder is not None:
                seen = self._whole.select(packed, spec).floats
                encoder.normaliser.observe(seen[..., : spec.observation_size])


class Value(nn.Module):
    """Value (n, G, ..., 1) of each of G agents, from features (n, G, ..., F).

    With `agents` > 1 the critic is central, as in MAPPO (Yu et al. 2022): it sees the features of all agents
    of the group, those of the agent itself first.
    """

    def __init__(self, features: int, hidden: Sequence[int], agents: int = 1) -> None:
        super().__init__()
        self._agents = agents
        self.body = perceptron(features * agents, hidden, 1)

    def forward(self, features: Tensor) -> Tensor:
        if self._agents > 1:
            features = torch.cat([features.roll(-each, 1) for each in range(self._agents)], -1)
        value: Tensor = self.body(features)
        return value


def split_encoders(
    architecture: Architecture, spec: PolicySpec, whole: PolicySpec
) -> tuple[Architecture, Architecture]:
    """The architectures of the policy and of privileged features, each with the encoders of its parts."""
    privileged = {*whole.keys} - {*spec.keys}
    hidden = {key: conf for key, conf in architecture.networks.items() if key in privileged}
    rest = {key: conf for key, conf in architecture.networks.items() if key not in privileged}
    return replace(architecture, networks=rest), replace(architecture, networks=hidden, prior=None)
