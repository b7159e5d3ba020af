"""The base of every world's settings."""

from dune_rl.settings import Settings


class WorldSettings(Settings):
    """Settings of a world; `name` says of which, so that settings read from a file find their class."""

    name: str
