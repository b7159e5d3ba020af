"""Maps of what LiDARs have seen, and the ways over them."""

from typing import Any

import numpy as np
import pytest

from dune_rl.sensors.perception.local_map import LocalMap
from dune_rl.sensors.perception.ways import way_left


def ways_past(map_: LocalMap, distance: float, scans: int, low: Any = None) -> float:
    """How much longer the way 6 m ahead is than straight on, after scans of a beam of length `distance`."""
    for _ in range(scans):
        map_.update(
            np.zeros((1, 3)), np.array([[distance]]), np.array([[distance < 10.0]]), np.zeros((1, 1), bool),
            np.array([[6.0, 0.0]]), low,
        )  # fmt: skip
    return way_left(map_.ways[0], map_.origins[0], 0.1, 0.1) - 6.0


def test_what_was_seen_for_long_outlasts_beams_that_pass_beside_it() -> None:
    wall, moment = (LocalMap(1, np.zeros(1), np.zeros(2)) for _ in range(2))
    nothing = ways_past(LocalMap(1, np.zeros(1), np.zeros(2)), 10.0, 20)
    assert ways_past(wall, 2.0, 40) > nothing + 0.2
    assert ways_past(wall, 10.0, 30) > nothing + 0.2
    assert ways_past(moment, 2.0, 11) > nothing + 0.2
    assert ways_past(moment, 10.0, 60) == pytest.approx(nothing, abs=0.05)


def test_ways_avoid_where_somebody_has_walked_until_the_map_begins_anew() -> None:
    map_ = LocalMap(2, np.linspace(-np.pi, np.pi, 64, endpoint=False), np.zeros(2))
    nothing, far = np.zeros((2, 64), bool), np.full((2, 64), 12.0)
    # Far enough to move the map along, and turned left: ahead is y.
    pose, goal = np.array([[20.0, -10.0, np.pi / 2]] * 2), np.array([[3.0, 0.0]] * 2)
    for y in np.linspace(-1.5, 1.5, 31):
        walker = np.array([[[1.5, y, 0.0, 1.0]], [[9.0, y, 0.0, 1.0]]])
        map_.update(pose, far, nothing, nothing, goal, movers=(walker, np.array([1, 0])))
    crossed, free = (way_left(map_.ways[row], map_.origins[row], 20.0, -10.0) for row in (0, 1))
    # Through a band of 0.8 m, at 2 a metre more.
    assert free == pytest.approx(3.0, abs=0.2) and crossed == pytest.approx(free + 1.6, abs=0.5)
    map_.forget(np.array([True, False]))
    map_.update(pose, far, nothing, nothing, goal)
    assert way_left(map_.ways[0], map_.origins[0], 20.0, -10.0) == pytest.approx(free, abs=0.05)


def test_low_obstacles_out_of_sight_stay_on_the_map() -> None:
    map_ = LocalMap(1, np.zeros(1), np.zeros(2))
    # Two cells of 0.1 m in one of the map's; the first has a step.
    places = np.array([[[[22, 0], [23, 0]]]], np.int32)
    seen = np.array([[[True, False]]]), places, 0.1
    nothing = ways_past(map_, 10.0, 20)
    assert ways_past(map_, 10.0, 20, seen) > nothing + 0.1
    assert ways_past(map_, 10.0, 20) > nothing + 0.1
    # Lower ground that is seen there from nearby takes it off, what is left of an old map does not.
    flat = np.zeros((1, 1, 1), bool), places[:, :, 1:], 0.1
    map_.update(
        np.array([[-4.0, 0.0, 0.0]]), np.array([[10.0]]), np.zeros((1, 1), bool), np.zeros((1, 1), bool),
        np.array([[12.0, 0.0]]), flat,
    )  # fmt: skip
    assert ways_past(map_, 10.0, 20) > nothing + 0.1
    assert ways_past(map_, 10.0, 20, flat) == pytest.approx(nothing, abs=0.05)


def test_what_a_scan_meets_on_known_ground_is_no_obstacle_but_a_step_there_is() -> None:
    """Nine cells of ground around the return 2 m ahead, without a step and with one; and only two of them."""
    x, y = np.meshgrid(np.arange(18, 23), np.arange(-2, 3))
    places = np.stack([x, y], axis=-1)[None].astype(np.int32)
    flat, stone = np.zeros((2, 1, 5, 5), bool)
    stone[0, 2, 2] = True
    wall, ground, step, part = (
        ways_past(LocalMap(1, np.zeros(1), np.zeros(2)), 2.0, 22, low)
        for low in (
            None,
            (flat, places, 0.1),
            (stone, places, 0.1),
            (flat[:, :1, :2], places[:, :1, :2], 0.1),
        )
    )
    assert wall > ground + 0.2 and step > ground + 0.2
    assert part == pytest.approx(wall, abs=0.05)
