"""What agents did on a map: examples of episodes, paths, tracks and endings."""

from dataclasses import replace

import numpy as np
import pytest
from map_pages import WORLDS, box, conf_of, site, texts, world_with
from rich.console import Console
from states import episode_state

from dune_rl.config.build import make_learning_env
from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.evaluation.policies import PolicySource
from dune_rl.reporting.views import maps
from dune_rl.reporting.views import tracks as view_tracks
from dune_rl.reporting.views.tracks import describe_ending
from dune_rl.state import ContactState
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.figure import draw_site_map
from dune_rl.visualization.site_map.layers import (
    SLOPE_CLASSES,
    GroundGrid,
    choose_spread_episodes,
    covered_by,
    site_statistics,
    slope_class,
    spawn_mask,
    water_props,
)
from dune_rl.visualization.site_map.panel import render_ground, render_passages

QUIET = Console(quiet=True)


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
    chosen = free.values_at(spawn_mask(here.spawner), ground.points)
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["random", "mppi"])
def test_built_in_policies_drive_as_in_an_evaluation(name: str) -> None:
    """Whatever the seed of the episodes is, of which neither draws its own chance."""
    limit = "task.terminations.time_limit.max_steps=25"
    conf = conf_of("+world=flat", "actors=none", f"policy={name}", "seed=9", "episodes=1", limit)
    (track,) = maps.drive_episodes(conf, QUIET)
    env = make_learning_env(conf, 1, conf.seed)
    policy = PolicySource(name, "built-in", name).load(env)
    env.set_seed(conf.seed)
    step = env.reset()
    for _ in range(20):
        step = env.step_mdp(env.step(policy(step)))
    position = env.base_env.simulation.state.groups["rover"].motion.position_w[0, :2]
    np.testing.assert_array_equal(track.points[20], position)
    env.close()


@pytest.mark.slow
def test_more_episodes_than_scenes_are_driven_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    conf = conf_of("+world=flat", "actors=none", "policy=go_to_goal", "episodes=3", "seed=4")
    together = maps.drive_episodes(conf, QUIET)
    monkeypatch.setattr(maps, "_MOST_SCENES", 2)
    for a, b in zip(together, maps.drive_episodes(conf, QUIET), strict=True):
        assert (a.episode, a.ending) == (b.episode, b.ending)
        np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.slow
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
    assert set(colours.ENDINGS) == {*view_tracks._ENDINGS.values(), *collided}
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


@pytest.mark.slow
def test_a_map_names_the_actors_that_have_no_room() -> None:
    cars = "+actors.traffic={body: car, controller: go_to_goal, count: 20}"
    with pytest.raises(WorldError, match=r"^traffic \(count 20\): agents\.traffic\.task\.spawn\.region"):
        maps.map_content(conf_of("+world=flat", cars), [])
    far = "+actors.traffic.task.spawn.min_goal_distance_m=15"
    with pytest.raises(
        WorldError, match=r"^traffic \(car\): agents\.traffic\.task\.spawn\.min_goal_distance_m=15"
    ):
        maps.map_content(conf_of("+world=flat", cars, far), [])
