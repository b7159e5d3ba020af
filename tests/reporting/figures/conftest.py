"""Rows of episodes as figures get them, with known numbers of successes."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

Row = dict[str, Any]


@pytest.fixture
def make_rows() -> Callable[..., list[Row]]:
    """Makes rows: of `count` episodes four on each site, the first `successes` succeed."""

    def make(
        count: int, successes: int, *, world: str = "inspection", name: str = "inspection-v1"
    ) -> list[Row]:
        return [
            {
                "policy": "planner",
                "set": name,
                "world": world,
                "seed": 7.0,
                "agent": "rover_0",
                "episode": float(number),
                "world_seed": 500.0 + number // 4,
                "success": float(number < successes),
                "collisions": float(number % 3),
                "time_to_goal": 5.0 + number if number < successes else np.nan,
                "clearance": 0.1 * (1 + number % 7),
                "goal_distance_m": 2.0 + 0.5 * number,
                "slope_deg": 1.0 * (number % 20),
            }
            for number in range(count)
        ]

    return make
