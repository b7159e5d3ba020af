"""Figures of aggregates show the values and intervals of the aggregates."""

from collections.abc import Callable

import numpy as np
import pytest

from dune_rl.reporting.figures.aggregates import (
    collect_scores,
    draw_aggregates,
    draw_improvements,
    draw_profiles,
)
from dune_rl.statistics.aggregates import aggregate_scores, probability_of_improvement


@pytest.fixture
def results(make_rows: Callable) -> dict:
    return {
        "a": {"planner": make_rows(40, 30), "random": make_rows(40, 3), "mppi": make_rows(40, 22)},
        "b": {"planner": make_rows(40, 18), "random": make_rows(40, 0), "mppi": make_rows(40, 20)},
    }


def marks(axes) -> dict[str, float]:
    return {line.get_label(): line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 1}


def test_points_are_the_aggregates(results: dict) -> None:
    found = collect_scores(results)
    assert found.units == "10 sites on 2 sets"
    figure = draw_aggregates(found)
    for axes, name in zip(figure.axes, ("IQM", "median", "mean", "optimality gap"), strict=True):
        assert name in axes.get_title(loc="left")
        assert marks(axes) == pytest.approx(
            {method: aggregate_scores(scores)[name].value for method, scores in found.scores.items()}
        )
    assert marks(figure.axes[2])["planner"] == pytest.approx(48 / 80)


def test_trained_policies_of_one_method_are_its_runs(results: dict) -> None:
    runs = {"planner": "SAC", "mppi": "SAC"}
    # "random" has one run: then the sites are the units of all.
    assert collect_scores(results, runs=runs).units == "10 sites on 2 sets"
    for methods in results.values():
        del methods["random"]
    found = collect_scores(results, runs=runs)
    assert found.units == "2 runs on 2 sets"
    np.testing.assert_allclose(found.scores["SAC"]["a"], [30 / 40, 22 / 40])


def test_profiles_are_steps_down_from_the_share_above_nothing(results: dict) -> None:
    axes = draw_profiles(collect_scores(results)).axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    assert list(lines) == ["planner", "random", "mppi"]
    for line in lines.values():
        assert (np.diff(line.get_ydata()) <= 0).all()
    # Of the random one, one site of ten has successes on the first cases, and none on the second.
    assert lines["random"].get_ydata()[0] == pytest.approx(0.05)


def test_pairs_have_intervals_and_many_a_matrix(results: dict, make_rows: Callable) -> None:
    found = collect_scores(results)
    axes = draw_improvements(found).axes[0]
    assert marks(axes) == pytest.approx(
        {
            f"{a} above {b}": probability_of_improvement(found.scores[a], found.scores[b]).value
            for a, b in (("planner", "random"), ("planner", "mppi"), ("random", "mppi"))
        }
    )
    many = collect_scores({"a": {f"m{i}": make_rows(40, 3 * i) for i in range(12)}})
    matrix = draw_improvements(many).axes[0]
    table = np.asarray(matrix.images[0].get_array().filled(np.nan))
    assert table.shape == (12, 12) and np.isnan(np.diag(table)).all()
    upper = np.triu_indices(12, 1)
    np.testing.assert_allclose(table[upper] + table.T[upper], 1.0)
    assert len(matrix.texts) == 12 * 11
    assert len(draw_aggregates(many).axes[0].get_yticklabels()) == 12
    assert len(draw_profiles(many).axes[0].lines) == 12


def test_one_method_no_successes_one_episode_and_no_values(make_rows: Callable) -> None:
    failing = collect_scores({"a": {"random": make_rows(8, 0)}})
    assert marks(draw_aggregates(failing).axes[0]) == {"random": 0.0}
    assert "one method alone" in draw_improvements(failing).texts[0].get_text()
    single = collect_scores({"a": {"random": make_rows(1, 1)}})
    assert marks(draw_aggregates(single).axes[0]) == {"random": 1.0}
    rows = [{**row, "success": np.nan} for row in make_rows(4, 0)]
    nothing = collect_scores({"a": {"x": rows, "y": make_rows(4, 1)}})
    assert "no value" in [text.get_text() for text in draw_aggregates(nothing).axes[0].texts]
    assert "no episode has a value" in draw_profiles(collect_scores({"a": {"x": rows}})).texts[0].get_text()
