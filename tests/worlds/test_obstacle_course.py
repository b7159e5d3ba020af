"""The obstacle course: fields with a way through, ends that starts and goals can be at, and shortest ways."""

import numpy as np
import pytest
from plain_worlds import box, plain
from world_digest import digest

from dune_rl.core.errors import WorldError
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.obstacle_course import ObstacleCourseConf, build_obstacle_course, draw_field
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.shortest_way import shortest_way_m
from dune_rl.worlds.validation import check_world

HALF_ROVER_M = 0.22


def test_the_same_seed_gives_the_same_course_and_another_another() -> None:
    one, again, other = (build_obstacle_course(ObstacleCourseConf(seed=seed)) for seed in (1, 1, 2))
    assert digest(one) == digest(again) != digest(other)
    check_world(one)


@pytest.mark.parametrize("seed", range(6))
def test_a_rover_fits_through(seed: int) -> None:
    world = build_obstacle_course(ObstacleCourseConf(seed=seed, fill=0.2))
    free = FreeSpace(world, HALF_ROVER_M, 25.0)
    ends = free.component_at([[-1.5, 0.0], [6.0, 0.0]])
    assert ends[0] == ends[1] > 0


def test_more_is_filled_at_a_higher_share() -> None:
    shares = [
        np.mean([draw_field(ObstacleCourseConf(seed=seed, fill=fill)).mean() for seed in range(8)])
        for fill in (0.0, 0.15, 0.2)
    ]
    assert shares[0] == 0.0 and shares[0] < shares[1] < shares[2]
    with pytest.raises(WorldError, match=r"world.fill=0.35 leaves no way of world.passage_m=1.5 m"):
        draw_field(ObstacleCourseConf(fill=0.35, passage_m=1.5))


def test_starts_and_goals_are_at_both_ends_where_ways_may_be_narrower_than_the_footprint() -> None:
    # A wall with a door of 0.7 m, too narrow for the disc that holds the rover.
    walls = [box(0.0, side * 5.35, 0.2, 10.0, 1.0) for side in (-1.0, 1.0)]
    draws = np.random.default_rng(0)
    for passage_m, are_joined in ((None, False), (0.5, True)):
        conf = SpawnConf(region="anywhere", passage_m=passage_m)
        spawner = Spawner(plain(*walls), conf, 0.38)
        sides = [np.sign([one.x, one.goal_x]) for one in (spawner.sample(draws) for _ in range(40))]
        assert any(side[0] != side[1] for side in sides) == are_joined


def test_the_shortest_way_leads_round_a_wall() -> None:
    world = plain(box(0.0, 0.0, 0.2, 4.0, 1.0))
    start, goal = np.array([-2.0, 0.0]), np.array([2.0, 0.0])
    # Round a corner at (0, 2), 0.3 m away from it.
    straight = 2 * np.hypot(2.0, 2.3)
    assert straight * 0.97 < shortest_way_m(world, start, goal, 0.3) < straight * 1.12
    assert shortest_way_m(world, start, np.array([-2.0, 3.0]), 0.3) == pytest.approx(3.0)
    closed = plain(*(box(x, 0.0, 0.2, 20.0, 1.0) for x in (0.0,)))
    assert shortest_way_m(closed, start, goal, 0.3) == np.inf
