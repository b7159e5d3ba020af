"""Maps: layers that agree with the world, the spawner and the agents, and what the command writes."""

import numpy as np
import pytest
from map_pages import WORLDS, box, ramp, site, world_with
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from dune_rl.core.seeding import stream
from dune_rl.geometry.heightfield import HeightField
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import (
    SLOPE_CLASSES,
    GroundGrid,
    contour_levels,
    covered_by,
    prop_footprints,
    slope_class,
    spawn_mask,
    vegetation_props,
    water_props,
)
from dune_rl.visualization.site_map.panel import draw_props
from dune_rl.worlds.world import World

# -- ground -------------------------------------------------------------------------------------------


def test_ground_is_the_terrain_s_at_the_centres_of_its_cells() -> None:
    ground = GroundGrid.sample(ramp(0.5), (-4.0, 4.0, -2.0, 2.0), 16, 8)
    assert ground.height.shape == ground.slope.shape == ground.shade.shape == (8, 16)
    np.testing.assert_allclose(ground.x[[0, -1]], [-3.75, 3.75])
    np.testing.assert_allclose(ground.height, np.tile(0.5 * ground.x, (8, 1)))
    np.testing.assert_allclose(ground.slope, np.arctan(0.5))


def test_light_comes_from_the_north_west() -> None:
    faces_west, faces_east = (
        GroundGrid.sample(ramp(slope), (-4.0, 4.0, -4.0, 4.0), 8, 8).shade for slope in (0.5, -0.5)
    )
    level = GroundGrid.sample(ramp(0.0), (-4.0, 4.0, -4.0, 4.0), 8, 8).shade
    np.testing.assert_allclose(level, 1.0)
    assert faces_west.min() > 1.0 > faces_east.max()


def test_slopes_fall_into_classes_and_the_limit_may_still_be_crossed() -> None:
    slope = np.deg2rad([0.0, 5.0, 5.1, 24.9, 25.0, 25.1, 80.0])
    assert slope_class(slope, 25.0).tolist() == [0, 0, 1, 4, 4, SLOPE_CLASSES, SLOPE_CLASSES]


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.15), (-3.0, 5.8), (120.3, 121.0), (-40.0, 900.0)])
def test_contours_lie_at_round_heights_within(low: float, high: float) -> None:
    levels = contour_levels(np.array([low, high]))
    assert 3 <= len(levels) <= 13
    assert low < levels[0] and levels[-1] < high
    step = levels[1] - levels[0]
    np.testing.assert_allclose(np.diff(levels), step)
    np.testing.assert_allclose(levels / step, np.rint(levels / step), atol=1e-6)


def test_a_plane_has_no_contours() -> None:
    assert not len(contour_levels(np.full(9, 4.0)))


def area(triangles: np.ndarray) -> float:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def test_things_are_seen_from_above_by_kind() -> None:
    found = prop_footprints(
        world_with(
            box("a", (0, 0, 0), (1, 2, 1)),
            box("b", (3, 3, 0), (4, 4, 1)),
            box("wall", (-5, -5, 0), (5, -4, 1), "wall"),
            box("deck", (-3, 0, 0), (-1, 3, 0.2), "bridge", drivable=True),
            box("sea", (-9, -9, 0), (9, 9, 0.1), "water", solid=False),
        ),
        7,
    )
    # What is driven on first, then obstacles, the largest first; water is no thing.
    assert [each.kind for each in found] == ["bridge", "wall", "box"]
    assert [each.drivable for each in found] == [True, False, False]
    # From above, without the upright faces and those on the ground.
    assert [area(each.triangles) for each in found] == pytest.approx([6.0, 10.0, 3.0])


def test_what_is_underground_is_not_on_the_map() -> None:
    # The ground rises toward x, at one in ten.
    found = prop_footprints(
        world_with(
            box("tank", (-3, -3, -4), (3, 3, -1)),
            box("buried half", (-2, 4, -5), (2, 5, 0), "wall"),
            slope=0.1,
        ),
        7,
    )
    assert [each.kind for each in found] == ["wall"]
    corners = found[0].triangles.reshape(-1, 2)
    np.testing.assert_allclose(corners.min(axis=0), [-2.0, 4.0], atol=0.01)
    np.testing.assert_allclose(corners.max(axis=0), [0.0, 5.0], atol=0.06)
    assert area(found[0].triangles) == pytest.approx(2.0, abs=0.1)


def test_a_beam_between_two_banks_is_on_the_map_though_its_ends_are_buried() -> None:
    x = np.linspace(-10.0, 10.0, 81)
    valley = HeightField(np.tile(0.2 * np.abs(x), (81, 1)), 0.25, (-10.0, -10.0))
    world = World("valley", valley, [box("beam", (-8, 0, 0.9), (8, 1, 1.0))], region=(-4.0, 4.0, -4.0, 4.0))
    corners = prop_footprints(world, 7)[0].triangles.reshape(-1, 2)
    np.testing.assert_allclose([corners[:, 0].min(), corners[:, 0].max()], [-5.0, 5.0], atol=0.05)


def test_the_last_of_many_kinds_are_put_together() -> None:
    props = [box(f"{n}", (n, 0, 0), (n + 0.9 - n / 10, 1, 1), f"kind {n}") for n in range(5)]
    found = prop_footprints(world_with(*props), 3)
    assert [each.kind for each in found] == ["kind 0", "kind 1", "other"]
    assert area(found[-1].triangles) == pytest.approx(0.7 + 0.6 + 0.5)


@pytest.mark.slow(all_but=["construction", "inspection", "island"])
@pytest.mark.parametrize("name", WORLDS)
def test_every_solid_prop_is_on_the_map(name: str) -> None:
    world = site(name).world
    solid = [prop for prop in world.props if prop.solid]
    assert {each.kind for each in site(name).footprints} == {prop.kind for prop in solid}
    corners = np.concatenate(
        [np.zeros((0, 2)), *(each.triangles.reshape(-1, 2) for each in site(name).footprints)]
    )
    for prop in solid:
        low, high = prop.vertices[:, :2].min(axis=0), prop.vertices[:, :2].max(axis=0)
        inside = corners[((corners >= low - 1e-9) & (corners <= high + 1e-9)).all(axis=1)]
        above = prop.vertices[prop.vertices[:, 2] > world.terrain.height(prop.vertices[:, :2]) + 0.01, :2]
        assert (inside.min(axis=0) <= above.min(axis=0) + 1e-3).all()
        assert (inside.max(axis=0) >= above.max(axis=0) - 1e-3).all()


def test_each_kind_is_drawn_in_a_colour_of_its_own() -> None:
    axes = Figure().add_subplot()
    found = site("inspection").footprints
    tints = {each.kind: tint for each, tint in zip(found[1:], colours.OBSTACLES, strict=False)}
    draw_props(axes, found, tints)
    drawn = [each for each in axes.collections if isinstance(each, PolyCollection)]
    assert [len(each.get_paths()) for each in drawn] == [len(f.triangles) for f in found for _ in range(2)]
    fills = {tuple(each.get_facecolor()[0]) for each in drawn[1::2]}
    assert len(fills) == len(found) > 5


def test_things_hide_ground_only_where_they_are_over_it() -> None:
    # A sea at the height of a ramp's middle covers its lower half.
    sea = box("sea", (-9, -9, -9), (9, 9, 0.0), "water", solid=False)
    world = world_with(sea, slope=0.5)
    ground = GroundGrid.sample(world.terrain, (-8.0, 8.0, -8.0, 8.0), 32, 32)
    np.testing.assert_array_equal(covered_by(water_props(world), ground), np.tile(ground.x < 0, (32, 1)))
    assert not covered_by([], ground).any()


def test_water_and_leaves_are_found() -> None:
    assert {prop.kind for prop in water_props(site("island").world)} == {"water"}
    assert {prop.kind for prop in vegetation_props(site("rubicon").world)} == {"leaves", "undergrowth"}


# -- starts, goals and paths --------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORLDS)
def test_the_marked_cells_are_the_spawner_s(name: str) -> None:
    spawner = site(name).spawner
    free = spawner.free_space
    mask = spawn_mask(spawner)
    np.testing.assert_allclose(free.centres(mask)[np.lexsort(free.centres(mask).T)],
                               spawner.cells[np.lexsort(spawner.cells.T)])  # fmt: skip
    assert free.traversable[mask].all()
    assert free.values_at(mask, spawner.cells).all()
    for episode in range(20):
        each = spawner.sample(stream(3, "spawn", episode))
        assert free.values_at(mask, np.array([[each.x, each.y], [each.goal_x, each.goal_y]])).all()


def test_points_beyond_the_world_are_in_no_cell() -> None:
    free = site("flat").spawner.free_space
    everywhere = np.ones(free.components.shape, bool)
    far = np.array([[1e3, 0.0], [0.0, -1e3], [0.0, 0.0]])
    assert free.values_at(everywhere, far).tolist() == [False, False, True]
