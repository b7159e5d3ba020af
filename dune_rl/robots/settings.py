"""The base of every robot's settings."""

from dune_rl.core.settings import Settings


class RobotSettings(Settings):
    """Settings of a robot; `name` selects the settings class when a file is read."""

    name: str

    @property
    def standing_height_m(self) -> float | None:
        """Height of the origin over level ground, where it is known before the robot is built."""
        return None
