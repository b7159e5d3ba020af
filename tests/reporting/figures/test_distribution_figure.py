"""Distributions: the points drawn are the episodes that have a value, and the others are counted."""

from collections.abc import Callable

import numpy as np

from dune_rl.reporting.figures.distributions import density, distribution_metrics, draw_distributions


def drawn(axes, name: str) -> np.ndarray:
    (points,) = [each for each in axes.collections if each.get_label() == name]
    return np.sort(points.get_offsets()[:, 0])


def test_points_are_the_values_and_what_has_none_is_counted(make_rows: Callable) -> None:
    results = {"inspection-v1": {"planner": make_rows(12, 5), "random": make_rows(12, 0)}}
    axes = draw_distributions(results, "time_to_goal").axes[0]
    np.testing.assert_allclose(drawn(axes, "planner"), [5.0, 6.0, 7.0, 8.0, 9.0])
    assert not [each for each in axes.collections if each.get_label() == "random"]
    assert [text.get_text() for text in axes.texts] == ["5 of 12", "0 of 12"]
    bar, median = axes.lines
    np.testing.assert_allclose(bar.get_xdata(), [6.0, 8.0])
    np.testing.assert_allclose(median.get_xdata(), [7.0])
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["planner", "random"]


def test_units_and_numbers_are_told(make_rows: Callable) -> None:
    figure = draw_distributions({"inspection-v1": {"planner": make_rows(12, 5)}}, "time_to_goal")
    assert figure.get_supxlabel() == "time to traverse [s]\n12 episodes on 3 sites"
    assert figure.axes[0].get_title(loc="left") == "inspection-v1"


def test_each_cases_have_a_panel_with_the_same_scale(make_rows: Callable) -> None:
    results = {
        "a": {"planner": make_rows(9, 9)},
        "b": {"planner": make_rows(30, 30), "random": make_rows(2, 2)},
        "c": {"random": make_rows(3, 3)},
        "d": {"planner": make_rows(1, 1)},
    }
    figure = draw_distributions(results, "clearance")
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(results)
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    assert len(drawn(figure.axes[1], "planner")) == 30
    # A method that is not in these cases leaves its row empty.
    assert [text.get_text() for text in figure.axes[2].texts] == ["3 of 3"]


def test_many_episodes_show_some_points_and_all_of_their_quartiles(make_rows: Callable) -> None:
    rows = make_rows(1000, 1000)
    axes = draw_distributions({"a": {"planner": rows}}, "time_to_goal").axes[0]
    points = drawn(axes, "planner")
    assert len(np.unique(points)) == 200 and set(points) <= {row["time_to_goal"] for row in rows}
    np.testing.assert_allclose(axes.lines[0].get_xdata(), np.quantile(np.arange(5, 1005), [0.25, 0.75]))
    assert axes.texts[0].get_text() == "1000 of 1000"


def test_a_density_stays_between_the_values_and_needs_some() -> None:
    x, height = density(np.array([0.0, 1.0, 2.0, 7.0, 7.5]))
    assert (x[0], x[-1]) == (0.0, 7.5) and height.max() == 1.0 and (height > 0).all()
    assert density(np.array([1.0, 1.0, 2.0, 3.0, 3.0])) is None
    assert density(np.zeros(50)) is None


def test_twelve_methods_one_episode_and_no_value(make_rows: Callable) -> None:
    twelve = {f"runs/sweep/{i}": make_rows(8, 4) for i in range(12)}
    figure = draw_distributions({"a": twelve}, "time_to_goal")
    assert [tick.get_text() for tick in figure.axes[0].get_yticklabels()] == [str(i) for i in range(12)]
    one = draw_distributions({"a": {"planner": make_rows(1, 1)}}, "time_to_goal")
    np.testing.assert_allclose(drawn(one.axes[0], "planner"), [5.0])
    for nothing in ({"a": {"planner": make_rows(5, 0)}}, {}):
        assert (
            "no episode has a value of time_to_goal"
            in draw_distributions(nothing, "time_to_goal").texts[0].get_text()
        )


def test_metrics_that_no_episode_has_and_shares_are_not_proposed(make_rows: Callable) -> None:
    assert distribution_metrics({"a": {"m": make_rows(4, 2)}}) == ["time_to_goal", "clearance", "collisions"]
    assert distribution_metrics({"a": {"m": make_rows(4, 0)}}) == ["clearance", "collisions"]
    assert distribution_metrics({}) == []
