"""When the agents of a group come and go in an episode."""

from typing import Self

from pydantic import Field, model_validator

from dune_rl.core.settings import Settings

_LONGEST_S = 1e5


class PresenceConf(Settings):
    """Settings of agents that come and go: each comes once, and does not return once it has left.

    Both times are drawn for each agent and episode, uniformly between the two bounds.
    """

    arrive_s: tuple[float, float] = Field((0.0, 0.0), description="earliest and latest arrival [s]")
    stay_s: tuple[float, float] | None = Field(None, description="shortest and longest [s]; null: to the end")

    @model_validator(mode="after")
    def _are_ranges(self) -> Self:
        for name, least in (("arrive_s", 0.0), ("stay_s", 0.1)):
            bounds = getattr(self, name)
            if bounds is not None and not least <= bounds[0] <= bounds[1] <= _LONGEST_S:
                raise ValueError(
                    f"{name} is the shortest and the longest time [s], from {least:g} to {_LONGEST_S:g} "
                    f"(got {list(bounds)})"
                )
        return self

    @property
    def is_from_the_start(self) -> bool:
        """Whether all agents are there when an episode starts."""
        return self.arrive_s[1] == 0.0
