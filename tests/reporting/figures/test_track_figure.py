"""Tracks on maps: the ways, speeds, collisions and endings that the recorded steps have."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from report_runs import methods_of

from dune_rl.config.build import build_world
from dune_rl.config.checks import validate
from dune_rl.config.schema import EnvConf
from dune_rl.reporting.figures.results import FAILURES, REACHED, ending_of, failures_of
from dune_rl.reporting.figures.track_data import collect_tracks, until_failure
from dune_rl.reporting.figures.tracks import SiteGround, draw_tracks, view_of
from dune_rl.reporting.inputs import EvaluationRun
from dune_rl.reporting.rows import StepTable

STEPS = (
    "policy", "agent", "episode", "x_m", "y_m", "speed_mps", "time_s", "collisions_so_far",
)  # fmt: skip
FLAT = {"world": {"name": "flat", "size_m": 40.0, "region_size_m": 8.0}}


def step_table(rows: list[dict[str, Any]]) -> StepTable:
    return StepTable(pyarrow.table({name: [row.get(name) for row in rows] for name in STEPS}))


def make_evaluation(
    make_rows: Callable, policies: list[str], episodes: int = 2, config: Any = None, **changed: Any
) -> EvaluationRun:
    """Robots that drive 3 m along x at 1, 2 and 3 m/s and touch something at the second step."""
    rows, steps = [], []
    for policy in policies:
        for row in make_rows(episodes, 1, world="flat", name="flat-v1"):
            start = {
                "start_x_m": 0.0,
                "start_y_m": row["episode"],
                "goal_x_m": 4.0,
                "goal_y_m": row["episode"],
            }
            end = {"reached": row["success"], "stuck": 1.0 - row["success"], "world_seed": np.nan}
            rows.append({**row, "policy": policy, **start, **end, **changed})
            for step in (1, 2, 3):
                pose = {
                    "x_m": float(step),
                    "y_m": row["episode"],
                    "speed_mps": float(step),
                    "time_s": step / 2,
                }
                common = {"policy": policy, "episode": row["episode"], "step": float(step)}
                steps.append({**common, "agent": "rover_0", **pose, "collisions_so_far": float(step >= 2)})
                walker = {**pose, "y_m": 9.0, "collisions_so_far": np.nan}
                steps.append({**common, "agent": "walker_0", **walker})
    return EvaluationRun(Path("e"), "e", FLAT if config is None else config, {}, rows, step_table(steps))


def ways(axes: Any) -> list[LineCollection]:
    return [each for each in axes.collections if isinstance(each, LineCollection)]


def test_a_track_has_the_places_speeds_collisions_and_walkers_of_its_steps(make_rows: Callable) -> None:
    (site,) = collect_tracks(methods_of(make_evaluation(make_rows, ["planner"])))
    assert (site.cases, site.world_seed, site.title) == ("flat-v1", None, "flat-v1")
    assert site.world is not None and site.world.extent == (-20.0, 20.0, -20.0, 20.0)
    first, second = site.tracks["planner"]
    np.testing.assert_allclose(first.points, [[0, 0], [1, 0], [2, 0], [3, 0]])
    np.testing.assert_allclose(first.speeds, [1, 2, 3])
    np.testing.assert_allclose(first.collisions, [[2, 0]])
    np.testing.assert_allclose(first.walkers, [[[1, 9, 0.5], [2, 9, 1.0], [3, 9, 1.5]]])
    assert (first.success, first.ending) == (True, REACHED)
    assert (second.success, second.ending) == (False, FAILURES["stuck"])
    # Walkers are no reason to see less of the robots.
    assert view_of(site)[3] < 9.0


def test_the_figure_draws_each_way_in_the_colours_of_its_speeds(make_rows: Callable) -> None:
    sites = collect_tracks(methods_of(make_evaluation(make_rows, ["planner", "random"])))
    figure = draw_tracks(sites)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in panels] == [
        "planner: 1 of 2 succeed",
        "random: 1 of 2 succeed",
    ]
    for axes in panels:
        lines = ways(axes)
        assert len(lines) == 2
        np.testing.assert_allclose(lines[0].get_array(), [1, 2, 3])
        np.testing.assert_allclose(np.array(lines[0].get_segments())[:, 1], [[1, 0], [2, 0], [3, 0]])
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "collision" in texts and "stuck" in texts and "out of time" not in texts
    assert any(axes.get_ylabel() == "forward speed [m/s]" for axes in figure.axes)


def test_five_methods_fill_a_second_row_in_part(make_rows: Callable) -> None:
    names = ["a", "b", "c", "d", "e"]
    figure = draw_tracks(collect_tracks(methods_of(make_evaluation(make_rows, names))))
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left")[0] for axes in panels] == names
    # One more for the colours.
    assert len(figure.axes) == len(names) + 1


def test_the_ends_of_tracks_are_their_last_seconds_before_the_failure(make_rows: Callable) -> None:
    (site,) = collect_tracks(methods_of(make_evaluation(make_rows, ["planner"])))
    track = site.tracks["planner"][1]
    crash = until_failure(track, "collision", 0.5)
    np.testing.assert_allclose(crash.points, [[1, 1], [2, 1]])
    np.testing.assert_allclose(crash.speeds, [2])
    np.testing.assert_allclose(crash.walkers[0], [[1, 9, 0.5], [2, 9, 1.0]])
    assert crash.ending is None and len(crash.collisions) == 1
    end = until_failure(track, "stuck", 0.5)
    np.testing.assert_allclose(end.points, [[2, 1], [3, 1]])
    assert end.ending is FAILURES["stuck"]
    whole = until_failure(track, "stuck", 60.0)
    np.testing.assert_allclose(whole.points, track.points)
    np.testing.assert_allclose(whole.walkers[0], track.walkers[0])


def test_sites_and_episodes_are_bounded(make_rows: Callable) -> None:
    evaluation = make_evaluation(make_rows, ["planner"], episodes=20)
    for row in evaluation.episodes:
        row["world_seed"] = 500.0 + row["episode"] // 5
    sites = collect_tracks(methods_of(evaluation), most_sites=2, most_episodes=3)
    assert [(site.world_seed, len(site.tracks["planner"])) for site in sites] == [(500, 3), (501, 3)]
    assert sites[1].title == "flat-v1, site 501"


def test_a_site_that_cannot_be_built_is_drawn_without_a_map(make_rows: Callable) -> None:
    config = {"world": {"name": "mesh", "path": "nowhere.obj"}}
    (site,) = collect_tracks(methods_of(make_evaluation(make_rows, ["planner"], config=config)))
    assert site.world is None
    panel = draw_tracks([site]).axes[0]
    assert "cannot be built" in panel.get_ylabel() and len(ways(panel)) == 2


def test_the_map_is_white_beyond_the_world_and_shows_its_objects() -> None:
    world = build_world(validate(EnvConf, {**FLAT, "world": {"name": "construction", "seed": 3}}).world)
    _, xmax, ymin, ymax = world.extent
    ground = SiteGround.of(world, (xmax - 10.0, xmax + 10.0, ymin, ymin + 20.0))
    columns = ground.picture.shape[1]
    np.testing.assert_allclose(ground.picture[:, columns // 2 + 1 :], 1.0)
    assert ground.picture[:, : columns // 2].min() < 1.0 and ymax > ymin + 20.0
    axes = Figure().subplots()
    ground.draw(axes)
    assert len(axes.images) == 1 and len(axes.collections) == len(ground.footprints) > 0


def test_steps_that_are_not_finite_are_left_out(make_rows: Callable) -> None:
    evaluation = make_evaluation(make_rows, ["planner"], episodes=1)
    steps = evaluation.steps.of("planner", [0.0])
    steps[2]["x_m"] = np.nan
    evaluation = replace(evaluation, steps=step_table(steps))
    (site,) = collect_tracks(methods_of(evaluation))
    np.testing.assert_allclose(site.tracks["planner"][0].points[:, 0], [0, 1, 3])


@pytest.mark.slow
def test_twelve_methods_go_on_in_further_rows_and_none_is_told(make_rows: Callable) -> None:
    twelve = make_evaluation(make_rows, [f"runs/{i}" for i in range(12)], episodes=1)
    figure = draw_tracks(collect_tracks(methods_of(twelve)))
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert titles == [f"{i}: 1 of 1 succeed" for i in range(12)]
    assert "no evaluation has steps" in draw_tracks([]).texts[0].get_text()
    without = EvaluationRun(Path("e"), "e", FLAT, {}, twelve.episodes)
    assert collect_tracks(methods_of(without)) == []


@pytest.mark.parametrize(
    ("row", "ending", "failures"),
    [
        ({"success": 1.0, "reached": 1.0, "collisions": 0.0}, "goal reached", []),
        ({"success": 0.0, "reached": 1.0, "collisions": 2.0}, "goal reached", ["collision"]),
        ({"flipped": 1.0, "stuck": 0.0, "collisions": 1.0}, "flipped", ["collision", "flipped"]),
        ({"timeout": 1.0, "collisions": np.nan}, "out of time", ["timeout"]),
        ({"success": 0.0}, None, []),
    ],
)
def test_endings_are_those_of_the_row(row: dict, ending: str | None, failures: list[str]) -> None:
    found = ending_of(row)
    assert (None if found is None else found.name) == ending
    assert failures_of(row) == failures


def test_policies_of_one_name_with_other_rows_are_told_apart(make_rows: Callable) -> None:
    one = make_evaluation(make_rows, ["planner"])
    other = make_evaluation(make_rows, ["planner"], success=0.0)
    again = EvaluationRun(Path("f"), "f", FLAT, {}, other.episodes, other.steps)
    names = [method.name for method in methods_of(one, again, one)]
    assert names == ["planner (e)", "planner (f)"]
