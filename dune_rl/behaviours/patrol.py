"""The behaviour `patrol`: from place to place of a list, with a wait at each."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.destinations import Destinations, DestinedBehaviour
from dune_rl.behaviours.ranges import PauseRange, Speed

_RANGE_M = 1_000.0


class Patrol(DestinedBehaviour):
    """Goes to `places` in turn, straight and past everybody, waits at each, and begins again after the last.

    Member k of the group begins at place k, so that members are spread. A place that cannot be reached,
    because something stands in the straight way, is left out after 4 s without progress.
    """

    motion_models = ("holonomic", "unicycle", "bicycle")

    def __init__(
        self,
        num_rows: int,
        *,
        places: Annotated[
            tuple[tuple[float, float], ...], Field(min_length=2, description="points [x, y] in turn [m]")
        ],
        speed_mps: Speed = 1.0,
        wait_s: PauseRange = (2.0, 2.0),
    ) -> None:
        destinations = Destinations(num_rows, "patrol", np.array(places, float), _RANGE_M, wait_s)
        super().__init__(num_rows, speed_mps, destinations)
