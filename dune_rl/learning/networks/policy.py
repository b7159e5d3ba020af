"""The policy network: one feature vector of all parts of an observation, then a tanh-normal action."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import GRUModule, ProbabilisticActor, TanhNormal

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import advise
from dune_rl.learning.networks.registry import ENCODERS, parse_encoder
from dune_rl.learning.networks.settings import NetworkConf
from dune_rl.learning.policy_spec import PackedObservation, PartSpec, PolicySpec
from dune_rl.sensors.registry import SENSORS

_LEAST_RANGE_M = 1e-3
# Shorter scans go to the networks as they are.
_SHORTEST_SCAN = 8


@dataclass(frozen=True)
class Architecture:
    """Sizes of the networks, beside those of the spec: the settings of `learning` of the same names.

    `networks` has the settings of encoders, as plain data, by the part of the observation. `recurrent` are
    the units of a GRU behind the features; 0: none. `prior` is the part that features end with as it is.
    """

    hidden: tuple[int, ...]
    scan_channels: int = 0
    observation_clip: float = 10.0
    image_channels: tuple[int, ...] = (16, 32, 32)
    image_features: int = 64
    networks: Mapping[str, Any] = field(default_factory=dict)
    recurrent: int = 0
    prior: str | None = None

    @classmethod
    def of(cls, conf: NetworkConf) -> "Architecture":
        """The architecture that the settings of an algorithm describe."""
        return cls(
            conf.hidden,
            conf.scan_channels,
            conf.observation_clip,
            conf.image_channels,
            conf.image_features,
            {part: encoder.model_dump(mode="json") for part, encoder in conf.networks.items()},
            prior=getattr(conf, "prior", None),
        )

    def plain(self) -> dict[str, Any]:
        """Containers that `torch.load(weights_only=True)` reads."""
        return {**asdict(self), "hidden": list(self.hidden), "image_channels": list(self.image_channels)}

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> "Architecture":
        """The inverse of `plain`; a setting that a file lacks has its default."""
        lists = {key: tuple(data[key]) for key in ("hidden", "image_channels") if key in data}
        return cls(**{**data, **lists})


class Normaliser(nn.Module):
    """Running mean and variance of observation vectors (..., n), which it scales to about unit size.

    Of the entries in `logarithmic` (n,) it takes the logarithm first. On a linear scale of 12 m the last half
    metre before a wall would be a tenth of a standard deviation.
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
    """Makes one vector of the observation's parts, (..., `size`).

    The encoder of a part is the one that `architecture.networks` names. Without one, scans of equal length
    are convolved together, images one by one, and other vectors are passed on. The prior is the last one, and
    not normalised.
    """

    def __init__(self, spec: PolicySpec, architecture: Architecture) -> None:
        super().__init__()
        self._spec = spec
        _check_names(spec, architecture.networks)
        named, channels = architecture.networks, architecture.scan_channels
        scan = {"encoder": "scan", "channels": channels}
        image = {
            "encoder": "image",
            "channels": architecture.image_channels,
            "features": architecture.image_features,
        }
        self._scans = _equal_scans(spec, named) if channels else []
        self._images = [key for key in spec.images if key not in named]
        self._named = sorted(named)
        self._prior = architecture.prior
        if self._prior is not None and self._prior not in spec.sizes:
            known = SENSORS.settings_class(self._prior) is not None
            add = f"add +sensors.{self._prior}={{}}, without `privileged`"
            raise ConfigError(
                f"learning.prior={self._prior} is no vector that the policy observes; "
                f"{add if known else advise(self._prior, spec.sizes)}"
            )
        encoded = {*named, self._prior, *(key for keys in self._scans for key in keys)}
        self._vectors = [key for key in spec.sizes if key not in encoded]
        # The names of modules are those in published weights.
        self.normaliser = Normaliser(spec.range_columns, architecture.observation_clip)
        convolutions = nn.ModuleList(_make(scan, _stacked(spec, keys)) for keys in self._scans)
        self.scans = nn.ModuleDict({"convolutions": convolutions})
        self.images = nn.ModuleList(_make(image, spec.images[key]) for key in self._images)
        self.named = nn.ModuleList(_make(named[key], spec.part(key)) for key in self._named)
        self.size = sum(spec.sizes[key] for key in self._vectors)
        self.size += sum(encoder.size for _, encoder in self._encoders())
        self.size += 0 if self._prior is None else spec.sizes[self._prior]

    def _encoders(self) -> Iterator[tuple[Sequence[str], Any]]:
        yield from zip(self._scans, self.scans["convolutions"].children(), strict=True)
        yield from zip([[key] for key in self._images], self.images, strict=True)
        yield from zip([[key] for key in self._named], self.named, strict=True)

    def forward(self, *parts: Tensor) -> Tensor:
        """Features (..., size) of the parts, vectors (..., n_i) and images, in the spec's order."""
        vectors = len(self._spec.sizes)
        if not vectors:
            nothing = parts[0].new_zeros((*parts[0].shape[:-3], 0), dtype=torch.float32)
            return self._encode(nothing, parts)
        return self._encode(torch.cat(parts[:vectors], -1), parts[vectors:])

    def encode(self, observations: PackedObservation) -> Tensor:
        """Features (..., size) of the result of `PolicySpec.pack`."""
        return self._encode(*self._spec.unpack(observations))

    def _encode(self, vectors: Tensor, images: Sequence[Tensor]) -> Tensor:
        split = self.normaliser(vectors).split(list(self._spec.sizes.values()), -1)
        parts = dict(zip([*self._spec.sizes, *self._spec.images], [*split, *images], strict=True))
        found = [parts[key] for key in self._vectors]
        for keys, encoder in self._encoders():
            read = [parts[key] for key in keys]
            found.append(encoder(read[0] if len(read) == 1 else torch.stack(read, -2)))
        if self._prior is not None:
            raw = vectors.split(list(self._spec.sizes.values()), -1)
            found.append(raw[[*self._spec.sizes].index(self._prior)])
        return torch.cat(found, -1)


def _make(conf: Mapping[str, Any], part: PartSpec) -> nn.Module:
    encoder = ENCODERS.build(parse_encoder(conf), part)
    if not isinstance(encoder, nn.Module):
        raise ConfigError(
            f"the encoder {conf['encoder']!r} must be a torch.nn.Module, and is {encoder!r:.80}"
        )
    return encoder


def _equal_scans(spec: PolicySpec, named: Mapping[str, Any]) -> list[list[str]]:
    """The keys of the scans without an encoder of their own, grouped by length, shortest first.

    A vector as long as a scan, such as the velocity of what each segment sees, is one of its channels.
    """
    free = {key: length for key, length in spec.sizes.items() if key not in named}
    lengths = {length for key, length in free.items() if key in spec.ranges and length >= _SHORTEST_SCAN}
    return [[key for key, length in free.items() if length == each] for each in sorted(lengths)]


def _stacked(spec: PolicySpec, keys: Sequence[str]) -> PartSpec:
    length = spec.sizes[keys[0]]
    return PartSpec((length,) if len(keys) == 1 else (len(keys), length))


def _check_names(spec: PolicySpec, named: Mapping[str, Any]) -> None:
    for key in named:
        if key not in spec.keys:
            remedy = advise(key, spec.keys)
            raise ConfigError(
                f"learning.networks.{key} encodes no part of the observation; {remedy} (for one group of "
                "agents alone, write learning.groups.GROUP.networks)"
            )


FEATURES = "features"
# What a recurrent network remembers (..., 1, units), and where it begins anew (..., 1), bool.
MEMORY, BEGINS = "memory", "is_init"
_LOG_SCALE_MIN, _LOG_SCALE_MAX = -5.0, 2.0
# Of the usual weights of the last layer, where a policy is to begin with the same action everywhere.
_SMALL = 0.01


def perceptron(
    n_in: int, hidden: Sequence[int], n_out: int, norm: Callable[[int], nn.Module] | None = None
) -> nn.Sequential:
    """Linear layers with a ReLU after each but the last, and a layer `norm(width)` before each."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [*([] if norm is None else [norm(n_in)]), nn.Linear(n_in, width), nn.ReLU()]
        n_in = width
    return nn.Sequential(*layers, *([] if norm is None else [norm(n_in)]), nn.Linear(n_in, n_out))


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

    @torch.no_grad()
    def set_noise(self, scale: float) -> None:
        """Begin with about the middle of the action's bounds, and noise of this `scale`, whatever is seen."""
        share = (math.log(scale) - _LOG_SCALE_MIN) / (_LOG_SCALE_MAX - _LOG_SCALE_MIN)
        last = self.body[-1]
        assert isinstance(last, nn.Linear)
        last.weight.mul_(_SMALL)
        last.bias.copy_(torch.tensor([0.0, math.atanh(2 * share - 1)]).repeat_interleave(len(last.bias) // 2))


def load_weights(network: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Load a saved state; raises ValueError for weights not finite, RuntimeError where it does not fit."""
    network.load_state_dict(weights)
    # Buffers may be infinite, such as a temperature of none.
    if not all(bool(values.isfinite().all()) for values in network.parameters()):
        raise ValueError("weights that are not finite")


def make_policy_network(
    spec: PolicySpec, architecture: Architecture, device: torch.device | str = "cpu"
) -> TensorDictSequential:
    """From the observation's parts to "action": features, then a tanh-normal over the action's bounds.

    Its first module holds the normaliser and the encoder, its last is the actor that a loss takes. A
    recurrent network has a GRU between them, which also reads `MEMORY` and `BEGINS` and writes
    ("next", `MEMORY`).
    """
    features = Features(spec, architecture)
    units = architecture.recurrent
    actor = ProbabilisticActor(
        module=TensorDictModule(
            Actor(spec, units or features.size, architecture.hidden),
            in_keys=[FEATURES],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={
            "low": torch.tensor(spec.low, device=device),
            "high": torch.tensor(spec.high, device=device),
        },
    )
    encoder = TensorDictModule(features, in_keys=spec.keys, out_keys=[FEATURES])
    if not units:
        return TensorDictSequential(encoder, actor).to(device)
    memory = GRUModule(
        features.size,
        units,
        in_keys=[FEATURES, MEMORY, BEGINS],
        out_keys=[FEATURES, ("next", MEMORY)],
        device=device,
    )
    return TensorDictSequential(encoder, memory, actor).to(device)
