"""One feature vector of all parts of an observation."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from dune_rl.learning.networks.architecture import Architecture
from dune_rl.learning.networks.image_encoder import ImageEncoder
from dune_rl.learning.networks.normaliser import Normaliser
from dune_rl.learning.networks.scan_encoder import ScanEncoder
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec


class Features(nn.Module):
    """Makes one vector of the observation's parts: the vectors normalised, scans and images encoded."""

    def __init__(self, spec: PolicySpec, architecture: Architecture) -> None:
        super().__init__()
        self._spec = spec
        self.normaliser = Normaliser(spec.range_columns, architecture.observation_clip)
        self.scans = ScanEncoder(spec, architecture.scan_channels)
        encoders = [
            ImageEncoder(image, architecture.image_channels, architecture.image_features)
            for image in spec.images.values()
        ]
        self.images = nn.ModuleList(encoders)
        self.size = self.scans.size + sum(encoder.size for encoder in encoders)

    def forward(self, *parts: Tensor) -> Tensor:
        """Features (..., size) of the parts, vectors (..., n_i) and images, in the spec's order."""
        vectors = len(self._spec.sizes)
        if not vectors:
            nothing = parts[0].new_zeros((*parts[0].shape[:-3], 0), dtype=torch.float32)
            return self._encode(nothing, parts)
        return self._encode(torch.cat(parts[:vectors], -1), parts[vectors:])

    def encode(self, observations: PackedObservation) -> Tensor:
        """Features (..., size) of what `PolicySpec.pack` gives."""
        return self._encode(*self._spec.unpack(observations))

    def _encode(self, vectors: Tensor, images: Sequence[Tensor]) -> Tensor:
        features = self.scans(self.normaliser(vectors))
        if not images:
            return features
        seen = [encoder(image) for encoder, image in zip(self.images, images, strict=True)]
        return torch.cat([features, *seen], -1)
