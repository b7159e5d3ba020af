"""The render modes of environments."""

from collections.abc import Sequence
from typing import Literal

from dune_rl.core.errors import ConfigError

RenderMode = Literal["human", "rgb_array"] | None


def check_render_mode(mode: str | None, modes: Sequence[str]) -> None:
    """Raise ConfigError unless `mode` is None or one of `modes`."""
    if mode is not None and mode not in modes:
        raise ConfigError(f"render_mode must be {', '.join(map(repr, modes))} or None (got {mode!r})")
