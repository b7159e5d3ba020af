"""Who starts somewhere, in the words of errors."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SpawnedBody:
    """Who starts somewhere, in words for errors: `name` of the body, and what ground it `needs` beside room.

    `settings` is the path of its group's settings, such as `actors.traffic`; empty for robots that have the
    environment's.
    """

    name: str = "robot"
    needs: str = ""
    settings: str = ""

    @property
    def spawn(self) -> str:
        """The path of the group's settings of starts and goals."""
        return f"{self.settings}.task.spawn" if self.settings else "task.spawn"

    @property
    def fewer(self) -> str:
        """What to do for fewer of them."""
        return f"Lower {self.settings}.count" if self.settings else "Have fewer robots"
