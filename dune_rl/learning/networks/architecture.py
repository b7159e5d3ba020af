"""The sizes of a policy's networks."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Architecture:
    """Sizes of the networks, beside those of the spec: the settings of `learning` of the same names.

    `networks` has the settings of encoders, as plain data, by the part of the observation.
    """

    hidden: tuple[int, ...]
    scan_channels: int = 0
    observation_clip: float = 10.0
    image_channels: tuple[int, ...] = (16, 32, 32)
    image_features: int = 64
    networks: Mapping[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """Containers that `torch.load(weights_only=True)` reads."""
        return {**asdict(self), "hidden": list(self.hidden), "image_channels": list(self.image_channels)}

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> "Architecture":
        """The inverse of `plain`; a setting that a file lacks has its default."""
        lists = {key: tuple(data[key]) for key in ("hidden", "image_channels") if key in data}
        return cls(**{**data, **lists})
