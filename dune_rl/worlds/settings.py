"""The base of every world's settings."""

from dune_rl.core.settings import Settings


class WorldSettings(Settings):
    """Settings of a world; `name` selects the settings class when a file is read."""

    name: str
