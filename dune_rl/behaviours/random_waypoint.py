"""The behaviour `random_waypoint`: to a random place, a pause, to the next one."""

import numpy as np

from dune_rl.behaviours.destinations import Destinations, DestinedBehaviour
from dune_rl.behaviours.ranges import PauseRange, Range, Speed


class RandomWaypoint(DestinedBehaviour):
    """Goes straight to a random place within `range_m` of where it started, pauses, and goes to the next one.

    The mobility model of Johnson & Maltz, "Dynamic source routing in ad hoc wireless networks" (1996), of one
    speed, with ways that are free of obstacles, and past everybody.
    """

    motion_models = ("holonomic", "unicycle", "bicycle")

    def __init__(
        self, num_rows: int, *, speed_mps: Speed = 1.0, range_m: Range = 8.0, pause_s: PauseRange = (0.0, 3.0)
    ) -> None:
        nowhere = np.zeros((0, 2))
        destinations = Destinations(num_rows, "random_waypoint", nowhere, range_m, pause_s)
        super().__init__(num_rows, speed_mps, destinations)
