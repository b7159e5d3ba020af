"""The policy and the action-value network, and the running normalisation before them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from dune_rl.learning.image_encoder import ImageEncoder
from dune_rl.learning.layout import Layout, Packed
from dune_rl.learning.scan_encoder import ScanEncoder

FEATURES = "features"
_LEAST_RANGE_M = 1e-3
_LOG_SCALE_MIN, _LOG_SCALE_MAX = -5.0, 2.0


@dataclass(frozen=True)
class Architecture:
    """What shapes the networks beside the layout: the settings of `learning` of the same names."""

    hidden: tuple[int, ...]
    scan_channels: int = 0
    observation_clip: float = 10.0
    image_channels: tuple[int, ...] = (16, 32, 32)
    image_features: int = 64

    def plain(self) -> dict[str, Any]:
        """Containers that `torch.load(weights_only=True)` reads."""
        return {**asdict(self), "hidden": list(self.hidden), "image_channels": list(self.image_channels)}

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> "Architecture":
        """The inverse of `plain`."""
        # What a file does not know of is as it was before.
        lists = {key: tuple(data[key]) for key in ("hidden", "image_channels") if key in data}
        return cls(**{**data, **lists})


class Normaliser(nn.Module):
    """Running mean and variance of observation vectors (..., n), which it scales to about unit size.

    Of the entries in `logarithmic` (n,) it takes the logarithm first. On a
    linear scale of 12 m the last half metre before a wall would be a tenth of
    a standard deviation.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    logarithmic: Tensor

    def __init__(self, logarithmic: Tensor, clip: float) -> None:
        super().__init__()
        size = len(logarithmic)
        self.clip = clip
        self.register_buffer("logarithmic", logarithmic)
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("variance", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def observe(self, vectors: Tensor) -> None:
        """Merge `vectors` (k, n) into the statistics (Chan, Golub and LeVeque's pairwise update)."""
        batch = self._scaled(vectors).double()
        k = len(batch)
        mean, variance = batch.mean(0), batch.var(0, correction=0)
        total = self.count + k
        shift = mean - self.mean.double()
        merged = self.variance.double() * self.count + variance * k + shift**2 * (self.count * k / total)
        self.mean.copy_(self.mean.double() + shift * (k / total))
        self.variance.copy_(merged / total)
        self.count.copy_(total)

    def forward(self, vectors: Tensor) -> Tensor:
        """`vectors` normalised and clipped, same shape."""
        vectors = self._scaled(vectors)
        # The floor keeps a part that never moves (an empty LiDAR) from amplifying its first change.
        return ((vectors - self.mean) / (self.variance + 1e-4).sqrt()).clamp(-self.clip, self.clip)

    def _scaled(self, vectors: Tensor) -> Tensor:
        return torch.where(self.logarithmic, vectors.clamp(min=_LEAST_RANGE_M).log(), vectors)


class Features(nn.Module):
    """Makes one vector of the observation's parts: the vectors normalised, scans and images encoded."""

    def __init__(self, layout: Layout, architecture: Architecture) -> None:
        super().__init__()
        self._layout = layout
        self.normaliser = Normaliser(layout.range_columns, architecture.observation_clip)
        self.scans = ScanEncoder(layout, architecture.scan_channels)
        encoders = [
            ImageEncoder(image, architecture.image_channels, architecture.image_features)
            for image in layout.images.values()
        ]
        self.images = nn.ModuleList(encoders)
        self.size = self.scans.size + sum(encoder.size for encoder in encoders)

    def forward(self, *parts: Tensor) -> Tensor:
        """Features (..., size) of the parts, vectors (..., n_i) and images, in the layout's order."""
        vectors = len(self._layout.sizes)
        if not vectors:
            nothing = parts[0].new_zeros((*parts[0].shape[:-3], 0), dtype=torch.float32)
            return self._encode(nothing, parts)
        return self._encode(torch.cat(parts[:vectors], -1), parts[vectors:])

    def encode(self, observations: Packed) -> Tensor:
        """Features (..., size) of what `Layout.pack` gives."""
        return self._encode(*self._layout.unpack(observations))

    def _encode(self, vectors: Tensor, images: Sequence[Tensor]) -> Tensor:
        features = self.scans(self.normaliser(vectors))
        if not images:
            return features
        seen = [encoder(image) for encoder, image in zip(self.images, images, strict=True)]
        return torch.cat([features, *seen], -1)


def _perceptron(n_in: int, hidden: Sequence[int], n_out: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(n_in, width), nn.ReLU()]
        n_in = width
    return nn.Sequential(*layers, nn.Linear(n_in, n_out))


class Actor(nn.Module):
    """Location and scale of the action before its tanh, each (..., A), from features."""

    def __init__(self, layout: Layout, features: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.body = _perceptron(features, hidden, 2 * layout.action_size)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """In float32 also under autocast: the log-probability of a squashed action needs it."""
        loc, raw = self.body(features).float().chunk(2, -1)
        share = (torch.tanh(raw) + 1) / 2
        return loc, torch.exp(_LOG_SCALE_MIN + (_LOG_SCALE_MAX - _LOG_SCALE_MIN) * share)


class ActionValue(nn.Module):
    """Q(features, action), (..., 1), for actions in physical units, which it scales to [-1, 1]."""

    middle: Tensor
    half_range: Tensor

    def __init__(self, layout: Layout, features: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.body = _perceptron(features + layout.action_size, hidden, 1)
        self.register_buffer("middle", layout.middle)
        self.register_buffer("half_range", layout.half_range)

    def forward(self, features: Tensor, action: Tensor) -> Tensor:
        """In float32 also under autocast: targets are differences of large values."""
        scaled = (action - self.middle) / self.half_range
        return self.body(torch.cat([features, scaled], -1)).float()


def make_policy(
    layout: Layout, architecture: Architecture, device: torch.device | str = "cpu"
) -> TensorDictSequential:
    """From the observation's parts to "action": features, then a tanh-normal over the action's bounds.

    Its first module holds the normaliser and the encoder, its second is the actor that a loss takes.
    """
    features = Features(layout, architecture)
    actor = ProbabilisticActor(
        module=TensorDictModule(
            Actor(layout, features.size, architecture.hidden), in_keys=[FEATURES], out_keys=["loc", "scale"]
        ),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={
            "low": torch.tensor(layout.low, device=device),
            "high": torch.tensor(layout.high, device=device),
        },
    )
    encoder = TensorDictModule(features, in_keys=layout.keys, out_keys=[FEATURES])
    return TensorDictSequential(encoder, actor).to(device)


def make_action_value(
    layout: Layout, features: int, hidden: Sequence[int], device: torch.device | str = "cpu"
) -> TensorDictModule:
    """From `features` features and the action to "state_action_value"."""
    return TensorDictModule(
        ActionValue(layout, features, hidden), in_keys=[FEATURES, "action"], out_keys=["state_action_value"]
    ).to(device)
