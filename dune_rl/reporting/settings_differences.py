"""In which settings runs differ."""

from collections.abc import Mapping, Sequence
from typing import Any


def differing_settings(config: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The settings of `config` that are not the same in all `others`, by their names with dots."""
    flat, all_flat = _flatten(config), [_flatten(other) for other in others]
    return {
        name: value for name, value in flat.items() if any(other.get(name) != value for other in all_flat)
    }


def _flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in config.items():
        if isinstance(value, Mapping):
            found |= _flatten(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found
