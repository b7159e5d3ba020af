"""The shorthand `actors=`: walkers, from which agent groups are made."""

import math
from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from dune_rl.settings import Settings


class ActorConf(Settings):
    """A walker, who decides for it, and its path.

    `scripted` walks a path there and back at `speed_mps`; `external` is an
    agent of the environment, whose actions reach up to `speed_mps`. Without
    `waypoints` a random path is drawn at every reset.
    """

    kind: Literal["walker"] = "walker"
    controller: Literal["scripted", "external"] = "scripted"
    speed_mps: float = Field(1.0, gt=0.0, le=5.0)
    radius_m: float = Field(0.25, gt=0.0, le=2.0)
    height_m: float = Field(1.75, gt=0.0, le=5.0)
    waypoints: tuple[tuple[float, float], ...] = ()
    length_range_m: tuple[float, float] = (6.0, 16.0)
    # Distance to the rover at which an episode may start, where the path reaches that far.
    start_distance_m: float = Field(2.0, ge=0.0)

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if len(self.waypoints) == 1:
            raise ValueError("waypoints needs at least two points, or none for a random path (got 1)")
        if any(math.dist(a, b) < 0.1 for a, b in pairwise(self.waypoints)):
            raise ValueError("waypoints must lie at least 0.1 m apart, each from the next")
        if not 1.0 <= self.length_range_m[0] < self.length_range_m[1]:
            raise ValueError(f"length_range_m must rise from at least 1.0 (got {list(self.length_range_m)})")
        if self.height_m <= 2 * self.radius_m:
            raise ValueError(f"height_m ({self.height_m}) must be more than twice radius_m ({self.radius_m})")
        return self
