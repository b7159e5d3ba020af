"""The base of every `*Conf` class, and nested settings as plain data."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Frozen, typed settings; unknown keys, NaN and values out of range are refused on construction.

    A subclass stands beside the class it configures, states units in its field names (`range_m`, `rate_hz`)
    and ranges with `pydantic.Field(gt=0)` and the like. Nested settings are validated in one pass, so several
    faults are reported together.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)


def merge_nested(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with nested `changes`; mappings merge, everything else replaces."""
    out = dict(data)
    for name, value in changes.items():
        inner = out.get(name)
        if isinstance(value, Mapping) and isinstance(inner, Mapping):
            value = merge_nested(inner, value)
        out[name] = value
    return out


def copy_nested(value: Any) -> Any:
    """Nested mappings and lists, copied as dictionaries and lists."""
    if isinstance(value, Mapping):
        return {key: copy_nested(inner) for key, inner in value.items()}
    return [copy_nested(inner) for inner in value] if isinstance(value, list | tuple) else value
