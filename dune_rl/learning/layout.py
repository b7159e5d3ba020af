"""What a policy reads and commands: the observation's parts, in order, and the action's bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import EnvBase

from dune_rl.errors import CheckpointError

# A key of the environment's output that is measured, not observed.
METRICS_KEY = "metrics"


@dataclass(frozen=True)
class Layout:
    """Observation keys with their sizes, in the order in which they are concatenated, and action bounds.

    `low` and `high` are in the action's own (physical) units. `ranges` names the
    parts whose values are positive throughout, such as a LiDAR's: of those
    it is the ratio that matters, 0.3 m to 0.6 m as much as 3 m to 6 m.
    """

    sizes: Mapping[str, int]
    low: tuple[float, ...]
    high: tuple[float, ...]
    ranges: tuple[str, ...] = ()

    @classmethod
    def of(cls, env: EnvBase) -> "Layout":
        """The layout of a batched environment: every float vector that it observes, by name."""
        sizes = {
            key: spec.shape[-1]
            for key, spec in sorted(env.observation_spec.items())
            if key != METRICS_KEY and spec.dtype.is_floating_point and spec.ndim == len(env.batch_size) + 1
        }
        bounds = env.action_spec.space
        size = env.action_spec.shape[-1]
        return cls(
            sizes,
            tuple(bounds.low.reshape(-1, size)[0].tolist()),
            tuple(bounds.high.reshape(-1, size)[0].tolist()),
            tuple(key for key in sizes if _positive(env.observation_spec[key])),
        )

    @property
    def keys(self) -> list[str]:
        """Names of the observation's parts, in order."""
        return list(self.sizes)

    @property
    def observation_size(self) -> int:
        """Length of the concatenated observation."""
        return sum(self.sizes.values())

    @property
    def action_size(self) -> int:
        """Number of action components."""
        return len(self.low)

    @property
    def range_columns(self) -> Tensor:
        """Which entries of the concatenated observation are ranges, bool, shape (observation_size,)."""
        return torch.cat([torch.full((size,), key in self.ranges) for key, size in self.sizes.items()])

    @property
    def half_range(self) -> Tensor:
        """Half the width of each action component's interval, shape (A,)."""
        return (torch.tensor(self.high) - torch.tensor(self.low)) / 2

    @property
    def middle(self) -> Tensor:
        """Centre of each action component's interval, shape (A,)."""
        return (torch.tensor(self.high) + torch.tensor(self.low)) / 2

    def vector(self, observation: TensorDictBase) -> Tensor:
        """The parts concatenated, shape (..., observation_size)."""
        return torch.cat([observation.get(key) for key in self.sizes], -1)

    def plain(self) -> dict[str, Any]:
        """Containers that `torch.load(weights_only=True)` reads."""
        return {
            "sizes": dict(self.sizes),
            "low": list(self.low),
            "high": list(self.high),
            "ranges": list(self.ranges),
        }

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> "Layout":
        """The inverse of `plain`."""
        return cls(dict(data["sizes"]), tuple(data["low"]), tuple(data["high"]), tuple(data["ranges"]))

    def require(self, here: "Layout", source: str) -> None:
        """Raise unless a policy of this layout, read from `source`, fits the environment `here`."""
        faults = []
        for key in sorted({*self.sizes, *here.sizes}):
            there, now = self.sizes.get(key), here.sizes.get(key)
            if there is None:
                faults.append(f"{key} is missing there, {now} values here")
            elif now is None:
                faults.append(f"{key} has {there} values there, is missing here")
            elif there != now:
                faults.append(f"{key} has {there} values there, {now} here")
        theirs, ours = (
            ", ".join(f"[{low:g}, {high:g}]" for low, high in zip(each.low, each.high, strict=True))
            for each in (self, here)
        )
        if theirs != ours:
            faults.append(f"actions lie in {theirs} there, in {ours} here")
        if faults:
            raise CheckpointError(
                f"{source} was made for another environment: {'; '.join(faults)}.\n"
                "Use the robot and sensor settings that it was trained with (its run's folder holds them), "
                "or train anew."
            )


def _positive(spec: TensorSpec) -> bool:
    return isinstance(spec, Bounded) and bool((spec.space.low > 0).all())
