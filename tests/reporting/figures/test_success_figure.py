"""Success against distance and slope: shares and Wilson's intervals in bins."""

from collections.abc import Callable

import numpy as np
import pytest

from dune_rl.reporting.figures.success import draw_success_by, round_edges, success_by_bin
from dune_rl.statistics.intervals import estimate_proportion


def lines(axes) -> dict[str, np.ndarray]:
    return {each.get_label(): each.lines[0].get_xydata() for each in axes.containers}


def test_bins_are_round_and_hold_all_values() -> None:
    values = np.append(np.linspace(2.1, 11.9, 50), np.nan)
    np.testing.assert_allclose(round_edges(values), [2, 4, 6, 8, 10, 12])
    # The largest value is on an edge: it needs a bin to its right.
    edges = round_edges(np.linspace(2.0, 12.0, 51))
    assert edges[0] == 2.0 and edges[-1] > 12.0 and (np.histogram(np.linspace(2, 12, 51), edges)[0] > 0).all()
    assert round_edges(np.array([5.0])).tolist()[0] <= 5.0 < round_edges(np.array([5.0]))[-1]
    assert not len(round_edges(np.array([np.nan])))


def test_sparse_bins_are_joined() -> None:
    values = np.concatenate([np.linspace(0.0, 19.0, 200), [47.0, 58.0]])
    edges = round_edges(values)
    counts = np.histogram(values, edges)[0]
    assert edges[-1] > 58.0 and counts.sum() == 202 and (counts >= 0.05 * 202).all()
    few = np.histogram(values, round_edges(values, least=90))[0]
    assert few.sum() == 202 and (few >= 90).all() and len(few) == 2


def test_a_value_on_an_edge_is_in_the_bin_above(make_rows: Callable) -> None:
    rows = make_rows(3, 2)
    for row, distance in zip(rows, (1.9, 2.0, 3.9), strict=True):
        row["goal_distance_m"] = distance
    found = success_by_bin(rows, "goal_distance_m", np.array([0.0, 2.0, 4.0]))
    assert [(one.count, one.value) for one in found] == [(1, 1.0), (2, 0.5)]
    assert found[1] == estimate_proportion([True, False])


def test_rows_without_the_property_or_success_are_left_out(make_rows: Callable) -> None:
    rows = make_rows(4, 4)
    rows[0]["slope_deg"], rows[1]["success"] = np.nan, np.nan
    (found,) = success_by_bin(rows, "slope_deg", np.array([0.0, 20.0]))
    assert found.count == 2


def test_the_figure_has_shares_intervals_and_counts(make_rows: Callable) -> None:
    rows = make_rows(20, 10)
    figure = draw_success_by({"inspection-v1": {"planner": rows}}, "goal_distance_m")
    (axes,) = figure.axes
    edges = axes.get_xticks()
    bins = success_by_bin(rows, "goal_distance_m", np.array(edges))
    full = [one for one in bins if one.count]
    np.testing.assert_allclose(lines(axes)["planner"][:, 1], [one.value for one in full])
    (bars,) = axes.containers[0].lines[2]
    ends = [segment[:, 1] for segment in bars.get_segments()]
    np.testing.assert_allclose(ends, [[one.low, one.high] for one in full])
    counts = [int(text.get_text()) for text in axes.texts]
    assert counts == [one.count for one in bins] and sum(counts) == 20
    assert "[m]" in figure.get_supxlabel() and "20 episodes on 5 sites" in figure.get_supxlabel()


def test_methods_with_other_numbers_of_episodes_have_a_range_of_counts(make_rows: Callable) -> None:
    results = {"a": {"planner": make_rows(20, 10), "random": make_rows(10, 0)}}
    texts = [text.get_text() for text in draw_success_by(results, "goal_distance_m").axes[0].texts]
    assert any("\N{EN DASH}" in text for text in texts)


@pytest.mark.parametrize("name", ["goal_distance_m", "slope_deg"])
def test_twelve_methods_no_successes_and_one_episode(make_rows: Callable, name: str) -> None:
    results = {
        "a": {f"m{i}": make_rows(40, i) for i in range(12)},
        "b": {"m0": make_rows(40, 0)},
        "c": {"m0": make_rows(1, 1)},
        "d": {"m0": make_rows(8, 8)},
    }
    figure = draw_success_by(results, name)
    assert len(lines(figure.axes[0])) == 12
    np.testing.assert_allclose(lines(figure.axes[1])["m0"][:, 1], 0.0)
    np.testing.assert_allclose(lines(figure.axes[2])["m0"][:, 1], [1.0])


def test_evaluations_of_older_versions_are_told_and_left_out(make_rows: Callable) -> None:
    old = [{key: value for key, value in row.items() if key != "slope_deg"} for row in make_rows(5, 2)]
    assert "no episode has slope_deg" in draw_success_by({"a": {"m": old}}, "slope_deg").texts[0].get_text()
    both = draw_success_by({"a": {"m": old}, "b": {"m": make_rows(5, 2)}}, "slope_deg")
    assert [axes.get_title(loc="left") for axes in both.axes] == ["b"]


def test_a_property_that_does_not_vary_is_told(make_rows: Callable) -> None:
    rows = [{**row, "slope_deg": 0.0} for row in make_rows(5, 2)]
    figure = draw_success_by({"a": {"m": rows}}, "slope_deg")
    assert "steepest ground on the straight line to the goal [°]: 0 in all" in figure.texts[0].get_text()
    one = draw_success_by({"a": {"m": make_rows(1, 1)}}, "goal_distance_m")
    assert "straight distance from start to goal [m]: 2 in all" in one.texts[0].get_text()
