"""Way-points and ways that cannot be walked are named, with what is wrong where."""

import re

import numpy as np
import pytest
from plain_worlds import box, plain, wavy_world

from dune_rl.core.errors import WorldError
from dune_rl.trajectories.plan import plan_on_ground
from dune_rl.worlds.passage import water_depth
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.walkable_points import TerrainLimits
from dune_rl.worlds.world import Prop

LIMITS = TerrainLimits()
WALL = box(2.0, 0.0, 0.4, 4.0, 1.5)


def pond(x: float, y: float) -> Prop:
    return Prop("pond", "water", *upright_box((x, y), 0.0, -1.0, 0.5, 2.0, 2.0), solid=False)


def fault(world, points, mode="once", **limits) -> str:
    with pytest.raises(WorldError) as error:
        plan_on_ground(world, np.array(points, float), mode=mode, limits=TerrainLimits(**limits))
    return str(error.value)


def test_all_faulty_way_points_are_named_at_once():
    message = fault(plain(WALL, pond(-4, -4)), [(0, 0), (2, 0.5), (99, 0), (-4, -4), (1.7, -1)])
    lines = message.splitlines()
    assert len(lines) == 4
    assert "way-point 3, (99.00, 0.00), is outside the world, which has x from -10 to 10 m" in lines[0]
    assert "way-point 2, (2.00, 0.50), is in an obstacle: move it" in message
    near = next(line for line in lines if line.startswith("way-point 5"))
    assert re.search(
        r"is too near an obstacle \(0\.\d\d m from it, and radius_m is 0.25\): move it, or lo", near
    )
    assert "way-point 4, (-4.00, -4.00), is in water (0.50 m deep, and max_water_m is 0)" in message


def test_steep_way_points_are_named_and_a_higher_limit_admits_them():
    world = wavy_world(8.0)
    slope = float(np.rad2deg(world.terrain.slope(np.array([0.1, 0.1]))))
    assert slope > 40.0
    message = fault(world, [(0.1, 0.1), (3.0, 0.0)])
    assert f"way-point 1, (0.10, 0.10), is on too steep ground ({slope:.1f} degrees, and max_slope" in message
    plan_on_ground(world, np.array([(0.1, 0.1), (3.0, 0.0)]), limits=TerrainLimits(max_slope_deg=80.0))


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (
            [(0, 0), (4, 0)],
            r"^between way-points 1 and 2 the way is in an obstacle at \(1.\d\d, 0.00\): add [^\n]*$",
        ),
        ([(-6, 5), (0, 5), (0, 0), (4, 0)], r"^between way-points 3 and 4 the way is in an obstacle"),
        (
            [(0, 2.2), (4, 2.2)],
            r"^between way-points 1 and 2 the way is too near an obstacle at \(1.\d\d, 2.20\)",
        ),
        ([(0, 0), (-6, 6), (5, 5)], None),
    ],
)
def test_a_stretch_that_leads_through_an_obstacle_is_named(points, words):
    world = plain(WALL)
    if words is None:
        assert plan_on_ground(world, np.array(points, float), limits=LIMITS).duration_s > 10.0
    else:
        with pytest.raises(WorldError, match=words):
            plan_on_ground(world, np.array(points, float), mode="once", limits=LIMITS)


def test_the_last_stretch_of_a_loop_leads_to_the_first_way_point():
    message = fault(plain(WALL), [(0, 0), (2, -6), (6, 0)], mode="loop")
    assert "between way-points 3 and 1 the way is" in message and "between way-points 1" not in message


def test_stretches_through_water_over_steep_ground_and_over_the_edge_are_named():
    world = plain(pond(0, 0))
    assert "between way-points 1 and 2 the way is in water" in fault(world, [(-4, 0), (4, 0)])
    plan_on_ground(world, np.array([(-4.0, 0.0), (4.0, 0.0)]), limits=TerrainLimits(max_water_m=0.5))
    assert "the way is on too steep ground" in fault(wavy_world(8.0), [(-3.0, 0.0), (3.0, 0.0)])
    # The spline swings out between way-points at the edge.
    assert "the way is outside the world" in fault(plain(), [(9.9, -4), (9.9, 0), (9.0, 2), (0.0, 0.0)])


@pytest.mark.parametrize(
    ("points", "mode", "words"),
    [
        ([], "once", "waypoints must have at least 2"),
        ([(0, 0)], "once", r"at least 2, as \[\[x, y\], \[x, y\]\] \(got 1\)"),
        ([(0, 0), (1, 1)], "loop", "at least 3 for mode=loop"),
        ([(0, 0), (np.nan, 1)], "once", "finite"),
        ([(0, 0), (0, 0.05), (3, 3)], "once", "way-points 1 and 2 are less than 0.1 m apart: leave one out"),
        ([(0, 0), (3, 3), (0, 0)], "loop", "way-points 3 and 1 are less than 0.1 m apart"),
    ],
)
def test_points_that_make_no_way_are_refused(points, mode, words):
    with pytest.raises(WorldError, match=words):
        plan_on_ground(plain(), np.array(points, float).reshape(-1, 2), mode=mode)


def test_a_way_with_too_many_poses_is_refused():
    with pytest.raises(WorldError, match="at most 20,000 poses: raise spacing_m"):
        plan_on_ground(wavy_world(), np.array([(-28.0, 0.0), (28.0, 0.0)]), spacing_m=0.001)


def test_the_depth_of_water_is_its_surface_above_the_ground():
    world = wavy_world(0.4, pond(3.0, 3.0))
    xy = np.array([[3.0, 3.0], [2.5, 3.5], [10.0, 0.0]])
    expected = np.maximum(0.5 - world.terrain.height(xy), 0.0) * [1, 1, 0]
    np.testing.assert_allclose(water_depth(world, xy), expected, atol=1e-6)
    np.testing.assert_array_equal(water_depth(plain(), xy), 0.0)
