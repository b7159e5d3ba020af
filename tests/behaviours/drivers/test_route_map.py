"""Routes on hand-made maps, with lengths and costs known by geometry."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra
from yards import yard

from dune_rl.behaviours.drivers.route_map import RouteMap, plan_routes, shared_route_map
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.world import World

RADIUS_M = 0.4
# A wall across the yard from its lower edge to y = 6.
WALL = (0.0, -2.0, 0.0, 0.4, 16.0)
WINDOW = (-4.0, 4.0, -4.0, 4.0)


def route_of(routes: RouteMap, start_xy, goal_xy) -> np.ndarray:
    """Centres (P, 2) [m] of the cells of the cheapest route; empty without any."""
    _, nearest = routes._nearest_traversable
    source, cell = int(nearest[routes.cell_number(goal_xy)]), int(nearest[routes.cell_number(start_xy)])
    found, previous = dijkstra(routes._graph, indices=source, return_predecessors=True)
    if not np.isfinite(found[cell]):
        return np.zeros((0, 2))
    cells = [cell]
    while cells[-1] != source:
        cells.append(int(previous[cells[-1]]))
    row, column = np.divmod(np.array(cells), len(routes.x))
    return np.stack([routes.x[column], routes.y[row]], axis=-1)


def length_of(route: np.ndarray) -> float:
    return float(np.hypot(*np.diff(route, axis=0).T).sum())


@pytest.mark.parametrize("angle", np.deg2rad([0.0, 11.0, 26.6, 45.0, 70.0, 90.0, 160.0]))
def test_in_the_open_a_route_costs_its_length(angle: float) -> None:
    routes = RouteMap(yard(), RADIUS_M, 25.0)
    # Centres of cells, so that no route begins or ends aside.
    start = np.array([0.1, 0.1])
    goal = start + 0.2 * np.round(6.0 * np.array([np.cos(angle), np.sin(angle)]) / 0.2)
    straight = float(np.hypot(*(goal - start)))
    cost = routes.routes_to(goal, start).cost.ravel()[routes.cell_number(start)]
    assert straight * 0.999 <= cost <= straight * 1.028
    assert straight * 0.999 <= length_of(route_of(routes, start, goal)) <= straight * 1.028


def test_a_route_goes_round_the_end_of_a_wall() -> None:
    start, goal = np.array([-4.1, 0.1]), np.array([4.1, 0.1])
    routes = RouteMap(yard(WALL), RADIUS_M, 25.0)
    route = route_of(routes, start, goal)
    # It passes the wall's end, clear of it, ...
    crossing = route[np.abs(route[:, 0]) < 0.3]
    assert crossing[:, 1].min() >= 6.0 + RADIUS_M
    # ... is no shorter than a thread round the corner, and no longer than by points 1 m beyond the corners.
    assert 2 * np.hypot(3.9, 5.9) + 0.4 < length_of(route) < 1.028 * (2 * np.hypot(2.9, 6.9) + 2.4)
    without = route_of(RouteMap(yard(), RADIUS_M, 25.0), start, goal)
    assert length_of(without) == pytest.approx(8.2)


def test_a_route_leaves_room_beside_obstacles_where_there_is_room() -> None:
    world = yard(WALL)
    route = route_of(RouteMap(world, RADIUS_M, 25.0), [-4.1, 0.1], [4.1, 0.1])
    assert world.clearance(route).min() > RADIUS_M + 0.15


def test_metres_on_a_slope_cost_what_the_formula_says() -> None:
    # Half the limit: 1 + 2 * (1/2)^2 for each horizontal metre.
    rise = np.tan(np.deg2rad(12.5)) * np.arange(-10.0, 10.01, 0.5)
    ground = HeightField(np.tile(rise, (41, 1)), 0.5, (-10.0, -10.0))
    routes = RouteMap(World("ramp", ground, region=(-9, 9, -9, 9)), RADIUS_M, 25.0)
    start, goal = [0.1, -2.9], [0.1, 3.1]
    assert routes.routes_to(goal, start).cost.ravel()[routes.cell_number(start)] == pytest.approx(6.0 * 1.5)


@pytest.mark.parametrize(("angle", "goes_round"), [(5.0, False), (20.0, True), (35.0, True)])
def test_a_route_climbs_a_gentle_ridge_and_goes_round_a_steep_one(angle: float, goes_round: bool) -> None:
    # A ridge of 4 m from the lower edge to y = 3: at 20 degrees, a metre on it costs 2.28, which is more than
    # the detour; 35 degrees are beyond the limit.
    places = np.arange(-10.0, 10.01, 0.5)
    ridge = np.tan(np.deg2rad(angle)) * np.maximum(2.0 - np.abs(places), 0.0)
    heights = np.where(places[:, None] < 3.0, ridge, 0.0)
    world = World("ridge", HeightField(heights, 0.5, (-10.0, -10.0)), region=(-9, 9, -9, 9))
    route = route_of(RouteMap(world, RADIUS_M, 25.0), [-4.9, -0.9], [4.9, -0.9])
    straight = 9.8
    if not goes_round:
        assert length_of(route) == pytest.approx(straight)
        return
    # Round its end, and no farther from it than 1 m.
    assert 2 * np.hypot(4.9, 3.9) - 0.2 < length_of(route) < 1.028 * (2 * np.hypot(2.9, 4.9) + 4.0)
    assert np.rad2deg(world.terrain.slope(route)).max() < 5.0


def test_without_a_route_costs_fall_toward_the_goal_and_are_high() -> None:
    routes = RouteMap(yard((0.0, 0.0, 0.0, 0.4, 22.0)), RADIUS_M, 25.0)
    start, goal = np.array([-4.1, 0.1]), np.array([4.1, 0.1])
    assert len(route_of(routes, start, goal)) == 0
    cost = routes.routes_to(goal, start).cost.ravel()
    assert cost[routes.cell_number(start)] > 1_000.0
    assert cost[routes.cell_number([-6.1, 0.1])] > cost[routes.cell_number([-2.1, 0.1])] > 1_000.0
    assert cost[routes.cell_number([3.1, 0.1])] < 2.0


def test_far_detours_are_found_though_the_first_search_is_short() -> None:
    # Straight 2 m, round the wall some 14 m.
    routes = RouteMap(yard((0.0, -1.5, 0.0, 0.4, 17.0)), RADIUS_M, 25.0)
    start, goal = [-1.1, -4.1], [1.1, -4.1]
    assert 20.0 < routes.routes_to(goal, start).cost.ravel()[routes.cell_number(start)] < 60.0


def test_a_world_keeps_one_map_of_a_window_for_all_scenes() -> None:
    world = yard()
    kept = shared_route_map(world, (0.4, 25.0), WINDOW)
    assert shared_route_map(world, (0.4, 25.0), WINDOW) is kept
    assert shared_route_map(world, (0.3, 25.0), WINDOW) is not kept
    for right in range(20):
        shared_route_map(world, (0.4, 25.0), (-1.0, float(right), -1.0, 1.0))
    assert shared_route_map(world, (0.4, 25.0), WINDOW) is not kept


@pytest.mark.parametrize("half", [10, 50])
def test_a_narrow_gap_is_open_in_a_world_of_any_size(half: int) -> None:
    # A gap of 0.7 m, whose middle is at no centre of cells of 0.2 m; round the wall is farther than 20 m.
    world = yard((0.0, -5.27, 0.0, 0.4, 10.0), (0.0, 5.43, 0.0, 0.4, 10.0), half=half)
    start, goal = np.array([-3.1, 0.1]), np.array([3.1, 0.1])
    known, routes = plan_routes(world, (0.38, 25.0, 0.3), goal, start)
    assert known.cell_m == pytest.approx(0.1)
    assert routes.cost.ravel()[known.cell_number(start)] < 18.0
    ahead = routes.waypoint.ravel()[known.cell_number(start)]
    assert known.x[ahead % len(known.x)] == pytest.approx(start[0] + 0.8, abs=0.1)


def test_a_window_grows_until_it_has_the_cheapest_route() -> None:
    # Round a wall of 40 m, 1 m from both points.
    world = yard((0.0, 0.0, 0.0, 0.4, 40.0), half=28)
    start, goal = np.array([-1.1, 0.1]), np.array([1.1, 0.1])
    known, routes = plan_routes(world, (0.38, 25.0, 0.3), goal, start)
    assert 40.0 < routes.cost.ravel()[known.cell_number(start)] < 55.0


def test_cells_are_no_finer_than_they_can_be_in_large_windows() -> None:
    start, goal = np.array([-40.0, -40.0]), np.array([40.0, 40.0])
    known, _ = plan_routes(yard(half=50), (0.38, 25.0, 0.3), goal, start)
    assert known.cell_m == pytest.approx(0.25) and known.x[-1] == pytest.approx(49.875)


def test_a_route_leads_through_a_gap_that_the_robot_fits_lengthwise_and_costs_more_there() -> None:
    # A gap of 0.64 m in a wall across the yard.
    world = yard((0.0, -5.32, 0.0, 0.4, 10.0), (0.0, 5.32, 0.0, 0.4, 10.0))
    start, goal = [-3.1, 0.1], [3.1, 0.1]
    assert len(route_of(RouteMap(world, RADIUS_M, 25.0), start, goal)) == 0
    narrow = RouteMap(world, RADIUS_M, 25.0, 0.2)
    assert length_of(route_of(narrow, start, goal)) == pytest.approx(6.2, abs=0.2)
    cost = narrow.routes_to(goal, start).cost.ravel()[narrow.cell_number(start)]
    assert 8.0 < cost < 20.0


def test_what_was_blocked_is_gone_round_and_the_map_stays_as_it_was() -> None:
    routes = RouteMap(yard(), RADIUS_M, 25.0)
    start, goal = np.array([-3.1, 0.1]), np.array([3.1, 0.1])
    before = routes.routes_to(goal, start)
    blocked = routes.routes_to(goal, start, [[0.0, 0.1, 1.0]])
    here = routes.cell_number(start)
    # Round a disc of 1.4 m, by tangents and arc: 2 sqrt(3.1^2 - 1.4^2) + 1.4 (pi - 2 acos(1.4 / 3.1)).
    assert before.cost.ravel()[here] == pytest.approx(6.2)
    assert blocked.cost.ravel()[here] > 6.8
    assert blocked.clearance.ravel()[routes.cell_number([0.0, 0.1])] == 0.0
    again = routes.routes_to(goal, start)
    np.testing.assert_array_equal(again.cost, before.cost)
    np.testing.assert_array_equal(again.clearance, before.clearance)


def test_waypoints_lie_four_steps_ahead_on_the_route() -> None:
    routes = RouteMap(yard(), RADIUS_M, 25.0)
    start, goal = np.array([-3.1, 0.1]), np.array([3.1, 0.1])
    waypoint = routes.routes_to(goal, start).waypoint.ravel()
    at = waypoint[routes.cell_number(start)]
    assert at == routes.cell_number(start + np.array([0.8, 0.0]))
    assert waypoint[routes.cell_number(goal)] == routes.cell_number(goal)


def test_steep_ground_leaves_the_follower_less_room_the_nearer_it_is() -> None:
    places = np.arange(-10.0, 10.01, 0.5)
    ridge = np.tan(np.deg2rad(35.0)) * np.maximum(2.0 - np.abs(places), 0.0)
    world = World("ridge", HeightField(np.tile(ridge, (41, 1)), 0.5, (-10.0, -10.0)), region=(-9, 9, -9, 9))
    routes = RouteMap(world, RADIUS_M, 25.0)
    room = routes.routes_to([5.1, 0.1], [-5.1, 0.1]).clearance
    line = room[np.argmin(np.abs(routes.y - 0.1))]
    on_it, beside = np.abs(routes.x) < 1.9, (routes.x > 2.2) & (routes.x < 5.0)
    assert line[on_it].max() == pytest.approx(0.68 * RADIUS_M)
    assert (np.diff(line[beside]) > 0.1).all()
