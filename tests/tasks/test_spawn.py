"""Spawns and goals: checked by the props' surfaces and by a path, not by the grid that made them."""

import re
from collections import deque

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import cKDTree
from simulations import new_simulation

from dune_rl.core.errors import WorldError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.tasks.spawn import Placement, SpawnConf, Spawner
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

RADIUS_M = 0.37
_built: dict[int, World] = {}


def inspection(seed: int) -> World:
    if seed not in _built:
        _built[seed] = build_inspection(InspectionConf(seed=seed))
    return _built[seed]


def samples(spawner: Spawner, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    placed = [spawner.sample(rng) for _ in range(n)]
    return np.array([[p.x, p.y, p.yaw, p.goal_x, p.goal_y] for p in placed])


def obstacle_points(world: World) -> cKDTree:
    # Points all over the props' surfaces, of which those that stand in a robot's way: no grid, no rays.
    found = []
    rng = np.random.default_rng(0)
    for p in world.props:
        if not p.solid or p.drivable:
            continue
        a, b, c = np.moveaxis(p.vertices[p.faces], 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
        faces = rng.choice(len(area), size=int(1500 * area.sum()), p=area / area.sum())
        u, v = rng.uniform(size=(2, len(faces), 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        points = a[faces] + u * (b - a)[faces] + v * (c - a)[faces]
        above = points[:, 2] - world.terrain.height(points[:, :2])
        found.append(points[(above > 0.04) & (above < 0.44), :2])
    return cKDTree(np.concatenate(found))


def has_path(open_cells: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> bool:
    seen, queue = np.zeros_like(open_cells), deque([start])
    seen[start] = True
    while queue:
        row, column = queue.popleft()
        if (row, column) == goal:
            return True
        for step in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            inside = 0 <= step[0] < open_cells.shape[0] and 0 <= step[1] < open_cells.shape[1]
            if inside and open_cells[step] and not seen[step]:
                seen[step] = True
                queue.append(step)
    return False


@pytest.mark.slow(all_but=["0"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_five_hundred_placements_hold_all_promises(seed):
    world = inspection(seed)
    conf = SpawnConf()
    placed = samples(Spawner(world, conf, RADIUS_M), 500)
    points = np.concatenate([placed[:, :2], placed[:, 3:]])
    xmin, xmax, ymin, ymax = world.region
    assert (points >= [xmin, ymin]).all()
    assert (points <= [xmax, ymax]).all()
    assert (np.abs(placed[:, 2]) <= np.pi).all()
    assert np.hypot(*(placed[:, :2] - placed[:, 3:]).T).min() >= conf.min_goal_distance_m
    assert np.rad2deg(world.terrain.slope(points)).max() <= conf.max_slope_deg + 1e-6
    obstacles = obstacle_points(world)
    assert obstacles.query(points)[0].min() >= RADIUS_M + conf.margin_m - 0.025

    # A path exists by a search of our own: on another grid, in the world's corner.
    cell, low = 0.2, np.array([-31.0, -31.0])
    axis = np.arange(low[0] + cell / 2, -12.0, cell)
    centres = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    clear = obstacles.query(centres)[0] >= RADIUS_M - 0.025
    gentle = np.rad2deg(world.terrain.slope(centres)) <= conf.max_slope_deg + 1e-6
    open_cells = (clear & gentle).reshape(len(axis), len(axis))
    index = np.floor((points - low) / cell).astype(int)[:, ::-1]
    open_cells[tuple(index.T)] = True
    for start, goal in zip(index[:60], index[500:560], strict=True):
        assert has_path(open_cells, tuple(start), tuple(goal))


def test_placements_reach_all_of_the_region_and_every_yaw():
    placed = samples(Spawner(build_flat(FlatConf()), SpawnConf(), RADIUS_M), 1000)
    assert placed[:, :2].min() < -3.7
    assert placed[:, :2].max() > 3.7
    quarters = np.floor((placed[:, 2] + np.pi) / (np.pi / 2)).astype(int)
    assert np.bincount(quarters, minlength=4).min() > 180


def test_draws_come_from_the_given_generator_alone():
    first, second = (Spawner(inspection(1), SpawnConf(), RADIUS_M) for _ in range(2))
    np.random.seed(1)
    once = samples(first, 20, seed=4)
    np.random.seed(2)
    samples(second, 7, seed=99)
    np.testing.assert_array_equal(once, samples(second, 20, seed=4))
    assert not np.array_equal(once, samples(second, 20, seed=5))


def test_a_placement_is_plain_floats():
    placement = Spawner(build_flat(FlatConf()), SpawnConf(), RADIUS_M).sample(np.random.default_rng(0))
    assert isinstance(placement, Placement)
    assert all(type(value) is float for value in vars(placement).values())


def test_anywhere_and_a_rectangle_of_one_s_own():
    world = inspection(0)
    wide = samples(Spawner(world, SpawnConf(region="anywhere"), RADIUS_M), 300)
    assert np.ptp(wide[:, :2], axis=0).min() > 45.0
    assert np.abs(wide[:, :2]).max() <= 31.0
    own = samples(Spawner(build_flat(FlatConf()), SpawnConf(region=(10, 13, -7, -3)), RADIUS_M), 100)
    assert (own[:, :2] >= [10, -7]).all()
    assert (own[:, :2] <= [13, -3]).all()


def test_a_far_goal_is_found_even_where_hardly_any_is():
    conf = SpawnConf(min_goal_distance_m=10.9)
    placed = samples(Spawner(build_flat(FlatConf()), conf, RADIUS_M), 50)
    assert np.hypot(*(placed[:, :2] - placed[:, 3:]).T).min() >= 10.9


def divided_world() -> World:
    # A wall cuts the region in two unequal parts, and reaches from edge to edge.
    wall = upright_box([1.0, 0.0], np.pi / 2, -0.2, 2.0, 20.0, 0.3)
    terrain = HeightField(np.zeros((5, 5)), 5.0, (-10.0, -10.0))
    return World("divided", terrain, [Prop("wall", "wall", *wall)], region=(-4, 4, -4, 4))


def test_only_the_larger_of_two_parts_is_used():
    spawner = Spawner(divided_world(), SpawnConf(), RADIUS_M)
    placed = samples(spawner, 200)
    assert np.concatenate([placed[:, 0], placed[:, 3]]).max() < 1.0
    assert spawner.sample_points(np.random.default_rng(0), 100, 0.2)[:, 0].max() < 1.0


def test_starts_and_goals_are_on_land_unless_water_may_be_deeper() -> None:
    world = build_island(IslandConf(seed=500))
    on_land = samples(Spawner(world, SpawnConf(region="anywhere"), RADIUS_M), 200)
    ends = on_land[:, [0, 1, 3, 4]].reshape(-1, 2)
    assert world.terrain.height(ends).min() >= -0.1 - 1e-9
    wading = Spawner(world, SpawnConf(region="anywhere", max_water_m=1.0), RADIUS_M)
    assert world.terrain.height(samples(wading, 200)[:, :2]).min() < -0.5
    far = Spawner(world, SpawnConf(region="anywhere"), RADIUS_M)
    goals = [far.sample_goal(np.random.default_rng(i), ends[0], ends[:0], np.zeros(0)) for i in range(100)]
    assert world.terrain.height(np.array(goals)).min() >= -0.1 - 1e-9
    said = far.why_not(13.0, 13.0)
    assert re.fullmatch(r"is in water that is 0\.\d\d m deep, above task\.spawn\.max_water_m", said)
    with pytest.raises(WorldError, match=r"is all below more than task\.spawn\.max_water_m=0\.1 m of water"):
        Spawner(world, SpawnConf(region=(11.0, 13.0, 11.0, 13.0), min_goal_distance_m=0.5), RADIUS_M)


def test_points_have_the_clearance_asked_for():
    world = inspection(2)
    spawner = Spawner(world, SpawnConf(), RADIUS_M)
    points = spawner.sample_points(np.random.default_rng(0), 200, 0.6)
    assert points.shape == (200, 2)
    assert obstacle_points(world).query(points)[0].min() >= 0.575
    with pytest.raises(WorldError, match=r"9\.00 m of clearance"):
        spawner.sample_points(np.random.default_rng(0), 1, 9.0)


def test_impossible_requests_say_what_to_change():
    flat = build_flat(FlatConf())
    with pytest.raises(WorldError, match=r"spawn\.region \(45, 60, 0, 5\).*'flat'.*\(-50, 50, -50, 50\)"):
        Spawner(flat, SpawnConf(region=(45, 60, 0, 5)), RADIUS_M)
    with pytest.raises(WorldError, match=r"spawn\.min_goal_distance_m=20 .*1[01]\.\d\d m"):
        Spawner(flat, SpawnConf(min_goal_distance_m=20), RADIUS_M)
    with pytest.raises(WorldError, match=r"within 1 m of the world's edge"):
        Spawner(flat, SpawnConf(region=(49.2, 50, 0, 5)), RADIUS_M)
    with pytest.raises(WorldError, match=r"smaller than one cell"):
        Spawner(flat, SpawnConf(region=(0, 0.04, 0, 0.04)), RADIUS_M)


def test_steep_and_blocked_regions_say_so():
    x, _ = np.meshgrid(np.arange(21.0), np.arange(21.0))
    steep = World("steep", HeightField(x, 1.0, (0.0, 0.0)), region=(6, 14, 6, 14))
    with pytest.raises(WorldError, match=r"spawn\.max_slope_deg=25"):
        Spawner(steep, SpawnConf(), RADIUS_M)
    Spawner(steep, SpawnConf(max_slope_deg=46), RADIUS_M)
    block = upright_box([0, 0], 0.0, -0.2, 2.0, 9.0, 9.0)
    terrain = HeightField(np.zeros((5, 5)), 5.0, (-10.0, -10.0))
    blocked = World("blocked", terrain, [Prop("block", "wall", *block)], region=(-4, 4, -4, 4))
    with pytest.raises(WorldError, match=r"spawn\.margin_m=0\.1.*0\.00 m at most"):
        Spawner(blocked, SpawnConf(), RADIUS_M)


@pytest.mark.parametrize("region", ["somewhere", (1, 1, 0, 2), (0, 1, 3, 2), (0, 1, 2), (0, 1, 0, np.nan)])
def test_bad_regions_are_refused(region):
    with pytest.raises(ValidationError, match="region"):
        SpawnConf(region=region)


# -- goals of an episode under way -----------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_another_goal_is_away_from_all_that_is_taken(seed: int) -> None:
    world, conf = inspection(1), SpawnConf(min_goal_distance_m=3.0)
    spawner, rng = Spawner(world, conf, RADIUS_M), np.random.default_rng(seed)
    others = spawner.sample_points(rng, 6, RADIUS_M)
    apart = rng.uniform(0.5, 1.5, 6)
    start = spawner.sample_points(rng, 1, RADIUS_M)[0]
    goals = np.array([spawner.sample_goal(rng, start, others, apart) for _ in range(100)])
    assert np.hypot(*(goals - start).T).min() >= 3.0
    assert (np.hypot(*np.moveaxis(goals[:, None] - others, -1, 0)) >= apart).all()
    xmin, xmax, ymin, ymax = world.region
    assert (goals >= [xmin, ymin]).all()
    assert (goals <= [xmax, ymax]).all()
    assert obstacle_points(world).query(goals)[0].min() >= RADIUS_M + conf.margin_m - 0.025
    assert len(np.unique(goals, axis=0)) > 90


def test_another_goal_is_found_even_where_hardly_any_is() -> None:
    # Of 8 m by 8 m all but a corner of 1.2 m is within 9 m of another robot, at the corner across.
    spawner = Spawner(build_flat(FlatConf()), SpawnConf(), RADIUS_M)
    goals = samples_of_goals(spawner, np.zeros(2), np.array([[-4.0, -4.0]]), np.array([10.4]))
    assert np.hypot(*(goals + 4.0).T).min() >= 10.4


def test_another_goal_comes_as_close_as_it_can() -> None:
    spawner = Spawner(build_flat(FlatConf()), SpawnConf(), RADIUS_M)
    goals = samples_of_goals(spawner, np.array([3.0, 3.0]), np.array([[-4.0, -4.0]]), np.array([50.0]))
    # The corner is the farthest from (-4, -4).
    assert np.hypot(*(goals - 4.0).T).max() < 0.3


def samples_of_goals(spawner: Spawner, start: np.ndarray, taken: np.ndarray, apart: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.array([spawner.sample_goal(rng, start, taken, apart) for _ in range(30)])


def test_the_free_space_of_a_world_is_worked_out_once_for_all_who_are_in_it():
    world = inspection(0)
    one, other = (Spawner(world, SpawnConf(margin_m=margin), 0.3) for margin in (0.1, 0.2))
    assert one.free_space is other.free_space
    for conf, radius in ((SpawnConf(max_slope_deg=20.0), 0.3), (SpawnConf(), 0.4)):
        assert Spawner(world, conf, radius).free_space is not one.free_space


def test_goals_are_no_farther_than_told_where_the_region_has_such() -> None:
    conf = SpawnConf(region="anywhere", max_goal_distance_m=6.0)
    placed = samples(Spawner(inspection(3), conf, RADIUS_M), 60)
    distances = np.hypot(placed[:, 3] - placed[:, 0], placed[:, 4] - placed[:, 1])
    assert distances.min() >= 2.0 and distances.max() <= 6.0
    with pytest.raises(ValidationError, match=r"max_goal_distance_m=2 must be above min_goal_distance_m=2"):
        SpawnConf(max_goal_distance_m=2.0)


@pytest.mark.slow
def test_a_share_of_the_episodes_is_anywhere_in_the_world() -> None:
    spawn = {"region": (-2.0, 2.0, -2.0, 2.0), "anywhere_share": 0.5}
    simulation = new_simulation("flat", 12, task={"spawn": spawn})
    simulation.reset()
    starts = simulation.state.groups["rover"].motion.position_w[:, :2]
    inside = (np.abs(starts) <= 2.5).all(axis=1)
    assert 1 <= inside.sum() <= 11
    again = new_simulation("flat", 12, task={"spawn": spawn})
    again.reset()
    np.testing.assert_array_equal(again.state.groups["rover"].motion.position_w[:, :2], starts)
    simulation.close()
    again.close()
