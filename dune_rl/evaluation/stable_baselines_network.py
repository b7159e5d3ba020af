"""Builds the networks of Stable-Baselines3's actors again, from the names and shapes of their weights."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor, nn

# Kernel, stride of the convolutions of NatureCNN (Mnih et al., 2015), and their places among the layers.
_CONVOLUTIONS = ((0, 8, 4), (2, 4, 2), (4, 3, 1))


def take_images(used: dict[str, Tensor], normalizes: bool) -> dict[str, nn.Module]:
    """The networks of images by sensor, whose weights are taken out of `used`."""
    images: dict[str, nn.Module] = {}
    stem = "features_extractor.extractors."
    for sensor in sorted({name.split(".")[2] for name in used if name.startswith(stem)}):
        here = f"{stem}{sensor}."
        layers: list[nn.Module] = [_ChannelsFirst(255.0 if normalizes else 1.0)]
        for place, kernel, stride in _CONVOLUTIONS:
            weight, bias = (used.get(f"{here}cnn.{place}.{each}") for each in ("weight", "bias"))
            if weight is None or bias is None or weight.shape[2:] != (kernel, kernel):
                return {}
            layer = nn.Conv2d(weight.shape[1], weight.shape[0], kernel, stride)
            _set_weights(layer, weight, bias)
            layers += [layer, nn.ReLU()]
        weight, bias = (used.get(f"{here}linear.0.{each}") for each in ("weight", "bias"))
        if weight is None or bias is None:
            return {}
        images[sensor] = nn.Sequential(*layers, nn.Flatten(), _linear(weight, bias), nn.ReLU())
        known = [f"cnn.{place}" for place, *_ in _CONVOLUTIONS] + ["linear.0"]
        for layer_name in known:
            del used[f"{here}{layer_name}.weight"], used[f"{here}{layer_name}.bias"]
    return images


def take_layers(
    used: dict[str, Tensor], settings: Mapping[str, Any], activation: type[nn.Module], squashes: bool
) -> list[nn.Module]:
    """The layers from the features to the action, whose weights are taken out of `used`."""
    if not squashes:
        # PPO, A2C, TRPO: the mean of a Gaussian.
        hidden = _take_linear(used, "mlp_extractor.policy_net.")
        return _joined([*hidden, *_take_one(used, "action_net.")], activation)
    if "mu.weight" in used:
        # SAC, TQC: the mean before it is squashed.
        return [
            *_joined([*_take_linear(used, "latent_pi."), *_take_one(used, "mu.")], activation),
            nn.Tanh(),
        ]
    if any(name.startswith("latent_pi.") for name in used):
        # SAC with state-dependent exploration clips the mean.
        limit = float(settings.get("clip_mean", 2.0))
        layers = _joined([*_take_linear(used, "latent_pi."), *_take_one(used, "mu.0.")], activation)
        return [*layers, *([nn.Hardtanh(-limit, limit)] if limit > 0.0 else []), nn.Tanh()]
    # TD3, DDPG.
    return [*_joined(_take_linear(used, "mu."), activation), nn.Tanh()]


def _take_linear(used: dict[str, Tensor], stem: str) -> list[nn.Linear]:
    """Linear layers with activations between them, at the places 0, 2, 4, ... of a sequence."""
    found: list[nn.Linear] = []
    while layer := _take_one(used, f"{stem}{2 * len(found)}."):
        found += layer
    return found


def _take_one(used: dict[str, Tensor], stem: str) -> list[nn.Linear]:
    weight, bias = used.get(f"{stem}weight"), used.get(f"{stem}bias")
    if weight is None or bias is None or weight.ndim != 2 or bias.ndim != 1:
        return []
    del used[f"{stem}weight"], used[f"{stem}bias"]
    return [_linear(weight, bias)]


def _joined(layers: Sequence[nn.Linear], activation: type[nn.Module]) -> list[nn.Module]:
    found: list[nn.Module] = []
    for layer in layers:
        found += [activation(), layer] if found else [layer]
    return found


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    _set_weights(layer, weight, bias)
    return layer


def _set_weights(layer: nn.Linear | nn.Conv2d, weight: Tensor, bias: Tensor) -> None:
    layer.load_state_dict({"weight": weight, "bias": bias})


class _ChannelsFirst(nn.Module):
    """(N, height, width, channels) divided by `scale` as (N, channels, height, width)."""

    def __init__(self, scale: float) -> None:
        super().__init__()
        self._scale = scale

    def forward(self, image: Tensor) -> Tensor:
        return image.movedim(-1, 1) / self._scale
