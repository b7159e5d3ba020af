"""Places and way-points that settings give to actors, and that are outside, in water or in an obstacle."""

from typing import Any

import pytest
from plain_worlds import box, plain
from simulations import simulation_on

from dune_rl.core.errors import WorldError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop

# 0.5 m deep about (-4, -4), and a wall at x = 2; the world reaches to 10 m.
POND = Prop("pond", "water", *upright_box((-4.0, -4.0), 0.0, -1.0, 0.5, 2.0, 2.0), solid=False)
WALL = box(2.0, 0.0, 0.4, 4.0, 1.5)
GIVEN = [[5.0, 0.0], [2.0, 0.5], [-4.0, -4.0], [0.0, 99.0]]


def simulation_with(**actors: Any) -> VectorSimulation:
    return simulation_on(plain(WALL, POND), actors=actors, sensors=["goal"])


def lines_of_fault(**actors: Any) -> list[str]:
    with pytest.raises(WorldError) as error:
        simulation_with(**actors)
    return str(error.value).splitlines()


@pytest.mark.parametrize("name", ["patrol", "herd"])
def test_places_where_nobody_can_be_are_named_with_their_setting(name: str) -> None:
    sheep = {"body": "sheep", "controller": {"name": name, "places": GIVEN}}
    setting = "agents.flock.controller.places"
    assert lines_of_fault(flock=sheep) == [
        f"{setting}: place 4, (0.00, 99.00), is outside the world, which has x from -10 to 10 m and y from "
        "-10 to 10 m: move it",
        f"{setting}: place 2, (2.00, 0.50), is in an obstacle: move it",
        f"{setting}: place 3, (-4.00, -4.00), is in water (0.50 m deep, and agents.flock.body.max_water_m is "
        "0.3): move it, or raise agents.flock.body.max_water_m",
    ]


def test_places_that_the_body_can_reach_are_accepted() -> None:
    cow = {"body": "cow", "controller": {"name": "patrol", "places": [GIVEN[0], GIVEN[2]]}}
    simulation_with(cow=cow).close()


def test_faults_of_all_groups_are_told_at_once() -> None:
    walkers = {"body": "person", "controller": "path", "path": {"waypoints": [[0.0, 1.0], [5.0, 1.0]]}}
    children = {"body": "child", "controller": "path", "path": {"waypoints": [[-4.0, -4.0], [0.0, -20.0]]}}
    between, outside, water = lines_of_fault(walkers=walkers, children=children)
    assert between.startswith(
        "agents.walkers.path.waypoints: between way-points 1 and 2 the way is in an obstacle at (1."
    )
    assert outside.startswith(
        "agents.children.path.waypoints: way-point 2, (0.00, -20.00), is outside the world"
    )
    assert water.startswith(
        "agents.children.path.waypoints: way-point 1, (-4.00, -4.00), is in water (0.50 m"
    )


def test_a_way_too_near_an_obstacle_names_the_body() -> None:
    walkers = {"body": "person", "controller": "path", "path": {"waypoints": [[0.0, 2.1], [5.0, 2.1]]}}
    (line,) = lines_of_fault(walkers=walkers)
    assert "too near an obstacle at (1." in line and "the body's radius is 0.25)" in line
    assert line.endswith("add way-points that lead round it, or choose a smaller agents.walkers.body")


def test_the_last_stretch_of_a_loop_is_checked() -> None:
    path = {"waypoints": [[0.0, 0.0], [2.0, -6.0], [6.0, 0.0]], "mode": "loop"}
    lines = lines_of_fault(walkers={"body": "person", "controller": "path", "path": path})
    assert any("between way-points 3 and 1 the way is in an obstacle" in line for line in lines)
