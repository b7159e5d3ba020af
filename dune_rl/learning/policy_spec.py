"""What a policy reads and writes: an agent group's observation, part by part, and its action's bounds."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from dune_rl.bodies.motion import TurningCircle
from dune_rl.core.errors import CheckpointError

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

Array = NDArray[Any]


class PolicyMismatchError(CheckpointError):
    """A policy is for other observations or actions; the first line says which."""


class GroupMismatchError(PolicyMismatchError):
    """The policy in the file or folder `location` is for other observations or actions than those of `group`.

    The first line names the setting, too.
    """

    def __init__(self, message: str, group: str, location: str) -> None:
        super().__init__(message)
        self.group, self.location = group, location


@dataclass(frozen=True)
class PartSpec:
    """A part of an observation: a vector (n,), or an image (height, width, channels), uint8 or float32.

    Values are from `low` to `high`. Encoders get vectors normalised, and images as they are.
    """

    shape: tuple[int, ...]
    uint8: bool = False
    low: float = -math.inf
    high: float = math.inf

    @property
    def size(self) -> int:
        return math.prod(self.shape)


class PackedObservation(NamedTuple):
    """Observations as two matrices: `floats` (..., F), vectors first, and `octets` (..., B) of uint8."""

    floats: Tensor
    octets: Tensor


@dataclass(frozen=True)
class PolicySpec:
    """Observation keys with their sizes, in the order in which they are concatenated, and action bounds.

    `low` and `high` are in the action's own (physical) units. `ranges` names the parts whose values are
    positive throughout, such as a LiDAR's: of those it is the ratio that matters, 0.3 m to 0.6 m as much as 3
    m to 6 m. `sizes` are of the vectors; `images` follow them in the same way. All agents of a group have the
    same spec. `turning` is of bodies that cannot turn on the spot.
    """

    sizes: Mapping[str, int]
    low: tuple[float, ...]
    high: tuple[float, ...]
    ranges: tuple[str, ...] = ()
    images: Mapping[str, PartSpec] = field(default_factory=dict)
    turning: TurningCircle | None = field(default=None, compare=False)

    @classmethod
    def of(cls, env: "EnvBase", group: str, *, privileged: bool = False) -> "PolicySpec":
        """The spec of a group of `env`, with the `privileged` parts of its observation or without them."""
        # Environments of others have none.
        hidden = getattr(env, "privileged", {}).get(group, ())
        # All agents of all scenes have the bounds of the first.
        action = env.full_action_spec[group, "action"].space
        observation = {
            key: (spec.space.low[0, 0].numpy(), spec.space.high[0, 0].numpy())
            for key, spec in env.observation_spec[group, "observation"].items()
            if privileged or key not in hidden
        }
        found = cls.of_bounds(observation, (action.low[0, 0].numpy(), action.high[0, 0].numpy()))
        # Environments of others have no such bodies.
        return replace(found, turning=getattr(env, "turning_circles", {}).get(group))

    @classmethod
    def of_bounds(
        cls, observation: Mapping[str, tuple[Array, Array]], action: tuple[Array, Array]
    ) -> "PolicySpec":
        """The spec of what has these lowest and highest values: parts of an observation, and an action."""
        parts = dict(sorted(observation.items()))
        sizes = {
            key: low.shape[-1] for key, (low, _) in parts.items() if low.ndim == 1 and low.dtype.kind == "f"
        }
        images = {
            key: PartSpec(tuple(low.shape), low.dtype == np.uint8, float(low.min()), float(high.max()))
            for key, (low, high) in parts.items()
            if low.ndim == 3
        }
        ranges = tuple(key for key in sizes if (parts[key][0] > 0).all())
        low, high = action
        return cls(sizes, tuple(low.tolist()), tuple(high.tolist()), ranges, images)

    @property
    def keys(self) -> list[str]:
        """Names of the observation's parts, in order: vectors, then images."""
        return [*self.sizes, *self.images]

    def part(self, key: str) -> PartSpec:
        return self.images[key] if key in self.images else PartSpec((self.sizes[key],))

    @property
    def observation_size(self) -> int:
        """Length of the concatenated vectors."""
        return sum(self.sizes.values())

    @property
    def packed_sizes(self) -> tuple[int, int]:
        """Widths F and B of what `pack` returns."""
        floats = sum(image.size for image in self.images.values() if not image.uint8)
        octets = sum(image.size for image in self.images.values() if image.uint8)
        return self.observation_size + floats, octets

    @property
    def action_size(self) -> int:
        return len(self.low)

    @property
    def range_columns(self) -> Tensor:
        """Which entries of the concatenated vectors are ranges, bool, shape (observation_size,)."""
        columns = [torch.full((size,), key in self.ranges) for key, size in self.sizes.items()]
        return torch.cat([torch.zeros(0, dtype=torch.bool), *columns])

    @property
    def half_range(self) -> Tensor:
        """Half the width of each action component's interval, shape (A,)."""
        return (torch.tensor(self.high) - torch.tensor(self.low)) / 2

    @property
    def middle(self) -> Tensor:
        """Centre of each action component's interval, shape (A,)."""
        return (torch.tensor(self.high) + torch.tensor(self.low)) / 2

    def pack(self, observation: TensorDictBase) -> PackedObservation:
        """The parts of `observation` (...), flat and side by side."""
        shape = observation.batch_size
        device = observation.device
        floats = [torch.zeros(*shape, 0, device=device)]
        octets = [torch.zeros(*shape, 0, dtype=torch.uint8, device=device)]
        for key in self.keys:
            part = observation.get(key)
            if key in self.sizes:
                floats.append(part)
            else:
                (octets if self.images[key].uint8 else floats).append(part.flatten(-3))
        return PackedObservation(torch.cat(floats, -1), torch.cat(octets, -1))

    def unpack(self, packed: PackedObservation) -> tuple[Tensor, list[Tensor]]:
        """Vectors (..., observation_size), and each image (..., height, width, channels)."""
        vectors = packed.floats[..., : self.observation_size]
        images = []
        starts = {False: self.observation_size, True: 0}
        for image in self.images.values():
            matrix = packed.octets if image.uint8 else packed.floats
            start = starts[image.uint8]
            starts[image.uint8] = start + image.size
            images.append(matrix[..., start : start + image.size].unflatten(-1, image.shape))
        return vectors, images

    def select(self, packed: PackedObservation, part: "PolicySpec") -> PackedObservation:
        """Of observations packed by this spec, those parts that `part` has too, packed by it."""
        if part.keys == self.keys:
            return packed
        vectors, images = self.unpack(packed)
        values = dict(zip(self.sizes, vectors.split(list(self.sizes.values()), -1), strict=True))
        values |= zip(self.images, images, strict=True)
        chosen = {key: values[key] for key in part.keys}
        return part.pack(TensorDict(chosen, vectors.shape[:-1], device=vectors.device))

    def plain(self) -> dict[str, Any]:
        """Containers that `torch.load(weights_only=True)` reads."""
        return {
            "sizes": dict(self.sizes),
            "low": list(self.low),
            "high": list(self.high),
            "ranges": list(self.ranges),
            "images": {
                key: {"shape": list(each.shape), "bytes": each.uint8, "low": each.low, "high": each.high}
                for key, each in self.images.items()
            },
        }

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> "PolicySpec":
        # Files from before there were images have none.
        images = {
            key: PartSpec(tuple(each["shape"]), each["bytes"], each["low"], each["high"])
            for key, each in data.get("images", {}).items()
        }
        low, high = tuple(data["low"]), tuple(data["high"])
        return cls(dict(data["sizes"]), low, high, tuple(data["ranges"]), images)

    def only(self, keys: Collection[str]) -> "PolicySpec":
        """The same without the parts that are not among `keys`."""
        return replace(
            self,
            sizes={key: size for key, size in self.sizes.items() if key in keys},
            ranges=tuple(key for key in self.ranges if key in keys),
            images={key: image for key, image in self.images.items() if key in keys},
        )

    def require(self, here: "PolicySpec", source: str) -> None:
        """Raise PolicyMismatchError unless a policy of this spec, read from `source`, fits `here`."""
        keys = sorted({*self.keys, *here.keys})
        extents = [(key, self._extent(key), here._extent(key)) for key in keys]
        both = [each for each in extents if each[1] and each[2]]
        faults = [f"{key} has {there} there, {now} here" for key, there, now in both if there != now]
        if alone := [f"{key} ({there})" for key, there, now in extents if now is None]:
            faults.append(f"only the policy has {', '.join(alone)}")
        if alone := [f"{key} ({now})" for key, there, now in extents if there is None]:
            faults.append(f"only this environment has {', '.join(alone)}")
        theirs, ours = (
            ", ".join(f"[{low:g}, {high:g}]" for low, high in zip(each.low, each.high, strict=True))
            for each in (self, here)
        )
        if theirs != ours:
            faults.append(f"actions lie in {theirs} there, in {ours} here")
        if faults:
            raise PolicyMismatchError(
                f"{source} was made for another environment: {'; '.join(faults)}.\n"
                "Use the robot and sensor settings that it was trained with (its run's folder holds them), "
                "or train again."
            )

    def _extent(self, key: str) -> str | None:
        if key in self.sizes:
            return f"{self.sizes[key]} values"
        if key not in self.images:
            return None
        height, width, channels = self.images[key].shape
        return f"{height} by {width} pixels of {channels}"
