"""Maps: layers that agree with the world, the spawner and the agents, and what the command writes."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from rich.console import Console
from sites import write_site
from states import episode_state
from world_files import CRATE, write_yard

from dune_rl import view
from dune_rl.config.compose import compose_view
from dune_rl.config.schema import ViewConf
from dune_rl.geometry.heightfield import HeightField
from dune_rl.seeding import stream
from dune_rl.state import ContactState
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.view import endings, maps
from dune_rl.view.endings import describe_ending
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.figure import draw_site_map
from dune_rl.visualization.site_map.layers import (
    SLOPE_CLASSES,
    GroundGrid,
    cell_values_at,
    choose_spread_episodes,
    contour_levels,
    covered_by,
    prop_footprints,
    site_statistics,
    slope_class,
    spawn_mask,
    vegetation_props,
    water_props,
)
from dune_rl.visualization.site_map.panel import MapContent, Track, draw_props, render_ground, render_passages
from dune_rl.worlds.world import Prop, World

Call = Callable[..., int]
Corner = tuple[float, float, float]
WORLDS = ("flat", "inspection", "construction", "rubicon", "island")
QUIET = Console(quiet=True)
# Coarse maps, for tests that are not about their pixels.
COARSE = "dpi=72"


@pytest.fixture(name="call")
def _call(call: Call) -> Call:
    return partial(call, view.main)


def conf_of(*words: str) -> ViewConf:
    return compose_view([*words, "view=map", COARSE])


@cache
def site(world: str) -> MapContent:
    return maps.map_content(conf_of(f"+world={world}"), [])


def box(name: str, low: Corner, high: Corner, kind: str = "box", **more: bool) -> Prop:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    vertices = np.array(low) + corners * (np.array(high) - low)
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 7, 3), (1, 5, 7),
    ]  # fmt: skip
    return Prop(name, kind, vertices, np.array(faces, np.int32), **more)


def ramp(slope: float) -> HeightField:
    x = np.arange(21.0) - 10.0
    return HeightField(np.tile(slope * x, (21, 1)), 1.0, (-10.0, -10.0))


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


# -- things -------------------------------------------------------------------------------------------


def world_with(*props: Prop, slope: float = 0.0) -> World:
    return World("test", ramp(slope), props, region=(-4.0, 4.0, -4.0, 4.0))


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
    assert cell_values_at(free, mask, spawner.cells).all()
    for episode in range(20):
        each = spawner.sample(stream(3, "spawn", episode))
        assert cell_values_at(free, mask, np.array([[each.x, each.y], [each.goal_x, each.goal_y]])).all()


def test_points_beyond_the_world_are_in_no_cell() -> None:
    free = site("flat").spawner.free_space
    everywhere = np.ones(free.components.shape, bool)
    far = np.array([[1e3, 0.0], [0.0, -1e3], [0.0, 0.0]])
    assert cell_values_at(free, everywhere, far).tolist() == [False, False, True]


def test_examples_are_episodes_of_the_seed_that_lie_apart() -> None:
    spawner = site("rubicon").spawner

    def place_robots(episode: int) -> list[Placement]:
        return [spawner.sample(stream(5, "spawn", episode))]

    chosen = choose_spread_episodes(place_robots, 4, 1.2)
    assert len(chosen) == 4
    assert all(place_robots(episode) == placements for episode, placements in chosen.items())
    ends = {n: np.array([[p.x, p.y], [p.goal_x, p.goal_y]]) for n, (p,) in chosen.items()}
    for a, here in ends.items():
        for b, there in ends.items():
            if a != b:
                assert np.hypot(*(here[:, None] - there[None]).reshape(-1, 2).T).min() >= 1.2


@pytest.mark.parametrize("name", WORLDS)
def test_the_actors_paths_are_walkable(name: str) -> None:
    world, paths = site(name).world, site(name).paths
    assert len(paths) == 6
    xmin, xmax, ymin, ymax = world.extent
    for path in paths:
        assert ((path >= [xmin, ymin]) & (path <= [xmax, ymax])).all()
        assert world.clearance(path).min() >= 0.25
        steps = np.hypot(*np.diff(path, axis=0).T)
        assert steps.min() > 0.04 and steps.max() < 0.06
        assert steps.sum() > 6.0 - 0.1


def test_there_are_no_paths_where_nobody_walks() -> None:
    assert maps.map_content(conf_of("+world=flat", "actors=none"), []).paths == []


def test_way_points_are_the_path() -> None:
    walker = "{body: person, controller: path, path: {waypoints: [[-3, 0], [0, 2], [3, 0]]}}"
    conf = conf_of("+world=flat", f"agents={{rover: {{body: rover_zero}}, walker: {walker}}}")
    (path,) = maps.map_content(conf, []).paths
    np.testing.assert_allclose(path[0], [-3, 0], atol=1e-6)
    np.testing.assert_allclose(path[-1], [3, 0], atol=0.06)


# -- pictures of the ground ---------------------------------------------------------------------------


def test_the_ground_s_colours_tell_slope_starts_and_passages() -> None:
    here = site("inspection")
    free = here.spawner.free_space
    ground = GroundGrid.sample(here.world.terrain, here.world.extent, 320, 320)
    picture = render_ground(here, ground, 3.0)
    assert picture.shape == (320, 320, 3)
    assert picture.min() >= 0.0 and picture.max() <= 1.0
    steep = slope_class(ground.slope, here.max_slope_deg) == SLOPE_CLASSES
    covered = covered_by(water_props(here.world), ground)
    # Blue over red: purple for what is too steep, ochre for what is not.
    blueness = picture[..., 2] - picture[..., 0]
    chosen = cell_values_at(free, spawn_mask(here.spawner), ground.points)
    assert (blueness[steep & ~covered & ~chosen] > 0).all()
    assert (blueness[~steep & ~covered & ~chosen] <= 0).all()
    assert (blueness[covered] > 0.1).all()
    under = render_passages(here, ground, 3.0)[..., 3] > 0
    assert under.any() and (chosen[under]).all()


def test_figures_are_those_of_the_ground() -> None:
    world = world_with(box("a", (0, 0, -5), (2, 2, 5)), slope=0.25)
    spawner = Spawner(world, conf_of("+world=flat").task.spawn, 0.3)
    found = site_statistics(world, spawner.free_space, (-4.0, 4.0, -4.0, 4.0), 25.0)
    assert (found.width_m, found.depth_m) == (8.0, 8.0)
    assert found.relief_m == pytest.approx(0.25 * 7.9)
    assert found.median_slope_deg == found.steepest_tenth_deg == pytest.approx(np.rad2deg(np.arctan(0.25)))
    assert found.too_steep == 0.0
    # The distance that obstructs is told on the safe side: half a cell round the box.
    assert found.obstructed == pytest.approx(4.0 / 64.0, rel=0.15)
    assert found.traversable == pytest.approx(1.0 - (4.0 + 4 * 2 * 0.3 + np.pi * 0.3**2) / 64.0, abs=0.01)


# -- tracks -------------------------------------------------------------------------------------------


def test_tracks_are_those_of_the_episodes_of_the_seed() -> None:
    conf = conf_of("+world=flat", "actors=none", "policy=go_to_goal", "seed=4", "episodes=3")
    tracks = maps.drive_episodes(conf, QUIET)
    here = maps.map_content(conf, tracks)
    assert [each.episode for each in tracks] == list(here.episodes) == [0, 1, 2]
    for each in tracks:
        (start,) = here.episodes[each.episode]
        np.testing.assert_allclose(each.points[0], [start.x, start.y], atol=0.05)
        left = float(np.hypot(*(each.points[-1] - [start.goal_x, start.goal_y])))
        assert each.agent == "rover_0" and each.ending == "goal reached" and left < here.goal_distance_m
        assert np.hypot(*np.diff(each.points, axis=0).T).max() < 0.2


def test_more_episodes_than_scenes_are_driven_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    conf = conf_of("+world=flat", "actors=none", "policy=go_to_goal", "episodes=3", "seed=4")
    together = maps.drive_episodes(conf, QUIET)
    monkeypatch.setattr(maps, "_MOST_SCENES", 2)
    for a, b in zip(together, maps.drive_episodes(conf, QUIET), strict=True):
        assert (a.episode, a.ending) == (b.episode, b.ending)
        np.testing.assert_array_equal(a.points, b.points)


def test_all_agents_of_all_groups_have_tracks() -> None:
    words = ["robots=[rover_zero,rover_zero,leo_rover]", "policy=go_to_goal", "episodes=1"]
    conf = conf_of("+world=flat", *words)
    tracks = maps.drive_episodes(conf, QUIET)
    assert [each.agent for each in tracks] == ["rover_0", "rover_1", "leo_rover_0", "walker_0", "walker_1"]
    here = maps.map_content(conf, tracks)
    robots, walkers = tracks[:3], tracks[3:]
    for track, start in zip(robots, here.episodes[0], strict=True):
        np.testing.assert_allclose(track.points[0], [start.x, start.y], atol=0.05)
        assert track.ending is not None
    assert all(each.ending is None and np.ptp(each.points, axis=0).max() > 1.0 for each in walkers)
    found = texts(draw_site_map(here, "", "", 72))
    for label in ("0a", "0b", "0c", "tracks of other agents"):
        assert label in found


def test_every_ending_has_a_colour_and_a_mark() -> None:
    collided = {"goal reached, after a collision", "physics diverged"}
    assert set(colours.ENDINGS) == {*endings._ENDINGS.values(), *collided}
    styles = {*colours.ENDINGS.values(), colours.ending_style("battery empty")}
    assert len(styles) == len({mark for _, mark in styles}) == len(colours.ENDINGS) + 1


@pytest.mark.parametrize(
    ("ended", "collisions", "text"),
    [
        (["goal_reached"], 0, "goal reached"),
        (["goal_reached", "time_limit"], 2, "goal reached, after a collision"),
        (["time_limit", "stuck"], 0, "stuck"),
        (["time_limit"], 1, "out of time"),
        (["battery_empty"], 0, "battery empty"),
        ([], 0, "cut short"),
    ],
)
def test_endings_are_described(ended: list[str], collisions: int, text: str) -> None:
    names = ("goal_reached", "stuck", "time_limit", "battery_empty")
    state = replace(
        episode_state([0, 1], [3, 3]),
        endings={name: np.array([False, name in ended]) for name in names},
    )
    counts = np.array([0, collisions])
    state = replace(state, contacts=ContactState(counts > 0, counts, counts))
    assert describe_ending(state, 1) == text
    assert describe_ending(state, 0) == "cut short"


# -- the page -----------------------------------------------------------------------------------------


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_a_page_says_what_is_on_it() -> None:
    figure = draw_site_map(site("inspection"), "inspection", "world: seed 0", 72)
    found = texts(figure)
    for text in ("inspection", "world: seed 0", "the world", "starts and goals", "solar array", "water",
                 "bridge, drivable", "over 25°, too steep", "64 by 64 m", "8 by 8 m"):  # fmt: skip
        assert text in found
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert [axes.get_xlabel() for axes in panels] == ["x [m], east"] * 2
    assert panels[0].get_xlim() == (-32.0, 32.0)
    xmin, xmax, ymin, ymax = site("inspection").spawner.region
    assert panels[1].get_xlim()[0] < xmin and panels[1].get_xlim()[1] > xmax
    assert panels[1].get_ylim()[0] < ymin and panels[1].get_ylim()[1] > ymax
    for axes in panels:
        box_px = axes.get_window_extent()
        across, up = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
        assert box_px.width / across == pytest.approx(box_px.height / up, rel=1e-3)


def test_a_region_as_large_as_the_world_needs_one_panel() -> None:
    here = maps.map_content(conf_of("+world=flat", "task.spawn.region=anywhere", "world.size_m=20"), [])
    figure = draw_site_map(here, "flat", "", 72)
    assert "starts and goals" not in texts(figure)
    assert len([axes for axes in figure.axes if axes.get_xlabel()]) == 1


def test_the_closer_panel_holds_all_that_was_driven() -> None:
    here = site("flat")
    far = Track("rover_0", 0, np.array([[0.0, 0.0], [20.0, 3.0]]), "stuck")
    figure = draw_site_map(replace(here, tracks=[far]), "", "", 72)
    closer = [axes for axes in figure.axes if axes.get_xlabel()][1]
    assert closer.get_xlim()[1] > 20.0
    assert "stuck: 1 of 1" in texts(figure)


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("name", WORLDS)
def test_nothing_written_overlaps_or_leaves_the_page(name: str, driven: bool) -> None:
    here = site(name)
    if driven:
        track = np.stack(
            [np.linspace(*here.spawner.region[:2], 9), np.full(9, here.spawner.region[2])], axis=1
        )
        here = replace(
            here,
            tracks=[Track("rover_0", number, track, each) for number, each in enumerate(colours.ENDINGS)],
        )
    figure = draw_site_map(here, name, maps.subtitle(conf_of(f"+world={name}")), 72)
    figure.canvas.draw()
    page = next(axes for axes in figure.axes if axes.get_label() == "page")
    boxes = [(text.get_text(), text.get_window_extent()) for text in page.texts if text.get_text()]
    panels = [axes.get_window_extent() for axes in figure.axes if axes.get_xlabel()]
    for index, (text, here) in enumerate(boxes):
        assert here.x0 >= 0 and here.y0 >= 0 and here.x1 <= figure.bbox.x1 and here.y1 <= figure.bbox.y1, text
        assert not any(here.overlaps(panel) for panel in panels), text
        # A pixel is what hinting moves them by.
        for other, there in boxes[index + 1 :]:
            assert min(here.x1 - there.x0, there.x1 - here.x0) <= 1 or (
                min(here.y1 - there.y0, there.y1 - here.y0) <= 2
            ), (text, other)


# -- the command --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORLDS)
def test_each_world_has_a_map_of_the_stated_size(
    name: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(f"+world={name}", "view=map", COARSE) == 0
    assert capsys.readouterr().out == f"Written: views/{name}_map.png\n"
    with Image.open(folder / "views" / f"{name}_map.png") as picture:
        assert picture.format == "PNG"
        assert picture.size == (13 * 72, 8 * 72)
        assert len(picture.convert("RGB").getcolors(2**20)) > 100


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_an_imported_world_has_a_map(kind: str, call: Call, folder: Path) -> None:
    file = write_yard(folder, kind)
    words = ["+world=mesh", f"world.path={file.name}", "world.region=[-4,4,-4,4]"]
    assert call(*words, "view=map", COARSE) == 0
    assert (folder / "views" / f"mesh_{file.stem}_map.png").exists()
    conf = conf_of(*words)
    assert maps.title(conf) == f"mesh: {file.name}"
    assert str(folder) not in maps.subtitle(conf)
    corners = np.concatenate([each.triangles for each in maps.map_content(conf, []).footprints]).reshape(
        -1, 2
    )
    assert (np.abs(corners - CRATE).max(axis=1) < 0.51).sum() >= 6


def test_equal_settings_give_equal_bytes_and_a_seed_others(call: Call, folder: Path) -> None:
    words = ["+world=island", "view=map", COARSE, "policy=go_to_goal", "episodes=2"]
    words.append("task.terminations.time_limit.max_steps=60")
    made = []
    for more in (["out=a"], ["out=b"], ["out=c", "seed=1"]):
        assert call(*words, *more) == 0
        made.append((folder / more[0][4:] / "island_map.png").read_bytes())
    assert made[0] == made[1] != made[2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["+world=flat", "episodes=0"], "episodes must be at least 1 (got 0)"),
        (["+world=flat", "dpi=9000"], "dpi must be at most 600 (got 9000)"),
        (["+world=flat", "task.spawn.region=[90,99,0,9]"],
         "task.spawn.region (90, 99, 0, 9) reaches outside the world 'flat', "
         "which covers (-50, 50, -50, 50): choose a rectangle within that."),
        (["+world=flat", "out=file"],
         "cannot write file: a file of that name is in the way; choose another place"),
        (["+world=flat", "out=file/maps"],
         "cannot write file/maps: a part of the path is a file; choose another place"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(
    words: list[str], message: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "file").write_text("kept")
    assert call("view=map", *words) == 2
    assert capsys.readouterr().err == f"{message}\n"
    assert (folder / "file").read_text() == "kept"


@pytest.mark.parametrize(("words", "named"), [([], "+world=NAME"), (["+world=inspektion"], "inspection")])
def test_a_missing_or_misspelt_world_is_told_with_the_choices(
    words: list[str], named: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("view=map", *words) == 2
    error = capsys.readouterr().err
    assert named in error and error.count("\n") == 1
    assert not list(folder.iterdir())


def test_ctrl_c_leaves_no_half_a_file(call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupted)
    assert call("+world=flat", "view=map", COARSE) == 130
    assert not list((folder / "views").iterdir())


def test_the_regions_to_choose_from_are_on_the_map_with_their_numbers(tmp_path) -> None:
    content = maps.map_content(conf_of("+world=sdf", f"world.path={write_site(tmp_path, 'maze')}"), [])
    figure = draw_site_map(content, "maze", "", 72)
    panel, closer = figure.axes[1], figure.axes[2]
    numbers = {text.get_text(): text.xy for text in panel.texts if text.get_text() in "12"}
    for number, each in enumerate(content.world.region_candidates, start=1):
        assert numbers[f"{number}"] == (each.rectangle[0], each.rectangle[3])
    dashed = [patch for patch in panel.patches if patch.get_linestyle() not in ("-", "solid")]
    other = content.world.region_candidates[1].rectangle
    assert any(patch.get_xy() == (other[0], other[2]) for patch in dashed)
    assert not [text for text in closer.texts if text.get_bbox_patch() is not None]
    written = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "others to choose: world.region=2" in written
    assert "wall" in written
