"""Policies of Stable-Baselines3 out of their .zip files, without the library and without running code.

Such a file has the weights (`policy.pth`, tensors alone) and `data`, JSON whose objects are pickles with
readable copies of their attributes beside them. Only tensors and readable parts are used here: the network is
built again from the names and shapes of the weights. What cannot be told from these is refused.
"""

import io
import json
import pickle
import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.stable_baselines_network import take_images, take_layers
from dune_rl.geometry.arrays import Floats
from dune_rl.learning.policy_spec import PolicySpec

_LARGEST_DATA, _LARGEST_WEIGHTS = 64 * 2**20, 2**30
_LIBRARIES = ("stable_baselines3.", "sb3_contrib.")
_ACTIVATIONS = {
    each.__name__: each
    for each in (nn.ReLU, nn.Tanh, nn.ELU, nn.LeakyReLU, nn.SiLU, nn.GELU, nn.SELU, nn.Softplus, nn.Mish)
}
_EXTRACTORS = ("FlattenExtractor", "CombinedExtractor")
# What a policy does not need to act deterministically.
_NOT_THE_ACTOR = (
    *("critic.", "critic_target.", "actor_target.", "actor.log_std", "log_std", "value_net."),
    *("vf_features_extractor.", "mlp_extractor.value_net."),
)
_REMEDY = "Load it in a function of your own and give policy=MODULE:FUNCTION (docs/how_to/evaluate.md)."
Readings = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class StableBaselinesPolicy:
    """The actor of a file: maps readings by sensor name (N, ...) to actions (N, A), without exploring.

    `sensors` are the parts of the observation in the order in which they are concatenated; None where the
    policy was trained on flat observations, that is on all of them, by name. `bounds` are the lowest and
    highest actions (A,); a policy that squashes its output (SAC, TD3) spreads it between them.
    """

    path: Path
    sensors: tuple[str, ...] | None
    bounds: tuple[Floats, Floats]
    squashes: bool
    inputs: int
    images: Mapping[str, nn.Module]
    layers: nn.Module

    @torch.no_grad()
    def __call__(self, observation: Readings) -> NDArray[np.floating]:
        """The actions; raises ConfigError if the observation is not the one of the training."""
        names = sorted(observation) if self.sensors is None else self.sensors
        missing = [name for name in names if name not in observation]
        if missing:
            raise ConfigError(
                f"policy={self.path}: there is no sensor {', '.join(missing)}; there are "
                f"{', '.join(observation)}"
            )
        parts = []
        for name in names:
            reading = torch.from_numpy(np.ascontiguousarray(observation[name])).float()
            try:
                parts.append(self.images[name](reading) if name in self.images else reading.flatten(1))
            except RuntimeError:
                size = tuple(reading.shape[1:])
                raise ConfigError(
                    f"policy={self.path} was trained on other images than {name} of {size}"
                ) from None
        features = torch.cat(parts, 1)
        if features.shape[1] != self.inputs:
            raise ConfigError(
                f"policy={self.path} was trained on {self.inputs} values, and {', '.join(names)} have "
                f"{features.shape[1]}; take the sensors and the robot that it was trained with"
            )
        actions: Floats = self.layers(features).numpy()
        if not self.squashes:
            return actions
        low, high = self.bounds
        return low + (actions + 1.0) / 2.0 * (high - low)

    def require(self, spec: PolicySpec) -> None:
        """Raise ConfigError unless actions of an agent group have the bounds of the training."""
        here = np.array([spec.low, spec.high])
        there = np.array(self.bounds)
        if here.shape != there.shape or not np.allclose(here, there, rtol=1e-4):
            raise ConfigError(
                f"policy={self.path} was trained with actions in {_intervals(there)}, and here they lie in "
                f"{_intervals(here)}; take the robot that it was trained with, or undo the wrapper that "
                f"changed them.\n{_REMEDY}"
            )


def read_stable_baselines(path: Path) -> StableBaselinesPolicy:
    """The policy of a file that `model.save` wrote; raises ConfigError if it is another file or network."""
    data, weights = _read_zip(path)
    module = str(_readable(data, "policy_class").get("__module__"))
    settings = _readable(data, "policy_kwargs")
    space = _readable(data, "observation_space")
    if not module.startswith(_LIBRARIES):
        raise ConfigError(f"policy={path} has a policy class of its own ({module}).\n{_REMEDY}")
    for name in ("features_extractor_class", "features_extractor_kwargs", "squash_output"):
        value = str(settings.get(name, "None"))
        if value not in ("None", "False", "{}") and not value.rstrip("'>").endswith(_EXTRACTORS):
            raise ConfigError(f"policy={path} has {name}={value}, which is not read.\n{_REMEDY}")
    normalizes = str(settings.get("normalize_images", "True")) == "True"
    used = {name: value for name, value in weights.items() if not name.startswith(_NOT_THE_ACTOR)}
    prefix = "actor." if any(name.startswith("actor.") for name in used) else ""
    squashes = bool(prefix)
    activation = _activation(path, settings, nn.ReLU if squashes else nn.Tanh)
    used = {name.removeprefix(prefix): value for name, value in used.items()}
    if any(name.startswith("pi_features_extractor.") for name in used):
        # Where the critic has another, the actor's is stored under both names.
        used = {name: value for name, value in used.items() if not name.startswith("features_extractor.")}
    used = {name.replace("pi_features_extractor.", "features_extractor."): v for name, v in used.items()}
    try:
        images = take_images(used, normalizes)
        layers = take_layers(used, settings, activation, squashes)
    except (RuntimeError, IndexError, ValueError):
        raise ConfigError(
            f"policy={path} is damaged: its weights do not fit each other; save it again"
        ) from None
    if used or not layers:
        found = min(used, default="no actor")
        raise ConfigError(f"policy={path} has a network that is not read ({found}).\n{_REMEDY}")
    first = next(layer for layer in layers if isinstance(layer, nn.Linear))
    network, bounds = nn.Sequential(*layers).eval(), _bounds(path, data)
    sizes = [(each.in_features, each.out_features) for each in layers if isinstance(each, nn.Linear)]
    if any(out != into for (_, out), (into, _) in pairwise(sizes)) or sizes[-1][1] != len(bounds[0]):
        raise ConfigError(f"policy={path} is damaged: its layers do not fit each other; save it again")
    return StableBaselinesPolicy(
        path, _sensors(path, space), bounds, squashes, first.in_features, images, network
    )


def _read_zip(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {name: archive.getinfo(name).file_size for name in ("data", "policy.pth")}
            if sizes["data"] > _LARGEST_DATA or sizes["policy.pth"] > _LARGEST_WEIGHTS:
                raise ConfigError(f"policy={path} is larger than a policy can be.\n{_REMEDY}")
            data = json.loads(archive.read("data"))
            file = io.BytesIO(archive.read("policy.pth"))
        with warnings.catch_warnings():
            # On pickles of other formats, which are refused next.
            warnings.simplefilter("ignore")
            weights = torch.load(file, "cpu", weights_only=True)
    except OSError as error:
        raise ConfigError(f"policy={path} cannot be read: {error.strerror or error}") from None
    except (
        *(zipfile.BadZipFile, KeyError, ValueError, RuntimeError, EOFError, NotImplementedError),
        *(RecursionError, pickle.UnpicklingError),
    ):
        raise ConfigError(
            f"policy={path} is damaged, or was not written by Stable-Baselines3; give a .zip file of "
            "model.save"
        ) from None
    tensors = isinstance(weights, dict) and all(isinstance(each, Tensor) for each in weights.values())
    if not isinstance(data, dict) or not tensors:
        raise ConfigError(
            f"policy={path} has no weights of Stable-Baselines3; give a .zip file of model.save"
        )
    return data, {str(name): value.float() for name, value in weights.items()}


def _readable(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The readable attributes of an object; its pickle is left alone."""
    found = data.get(name)
    return found if isinstance(found, dict) else {}


def _activation(path: Path, settings: Mapping[str, Any], default: type[nn.Module]) -> type[nn.Module]:
    if "activation_fn" not in settings:
        return default
    name = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", str(settings["activation_fn"]))
    if name is None or name[1] not in _ACTIVATIONS:
        raise ConfigError(f"policy={path} has the activation {settings['activation_fn']}.\n{_REMEDY}")
    return _ACTIVATIONS[name[1]]


def _sensors(path: Path, space: Mapping[str, Any]) -> tuple[str, ...] | None:
    kind = str(space.get(":type:"))
    if kind.endswith("spaces.box.Box'>"):
        return None
    names = re.findall(r"'([^']+)': Box\(", str(space.get("spaces", "")))
    if not kind.endswith("spaces.dict.Dict'>") or not names:
        raise ConfigError(f"policy={path} was not trained on an environment of dune_rl ({kind}).\n{_REMEDY}")
    return tuple(names)


def _bounds(path: Path, data: Mapping[str, Any]) -> tuple[Floats, Floats]:
    space = _readable(data, "action_space")
    found = []
    for name in ("low", "high"):
        words = str(space.get(name, "")).strip("[] ").split()
        try:
            found.append(np.array([float(word) for word in words], np.float32))
        except ValueError:
            found.append(np.zeros(0, np.float32))
    low, high = found
    if not len(low) or low.shape != high.shape:
        raise ConfigError(
            f"policy={path} has no bounds of continuous actions; give a policy that was trained on dune_rl"
        )
    return low, high


def _intervals(bounds: NDArray[Any]) -> str:
    return ", ".join(f"[{low:g}, {high:g}]" for low, high in bounds.T)
