"""Training curves: what is drawn are the means and bands of the runs' rows."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from dune_rl.reporting.figures.training import (
    by_world,
    draw_training_curves,
    training_band,
)
from dune_rl.reporting.inputs import TrainingRun


def make_run(
    name: str,
    points: list[tuple[float, float]],
    *,
    kind: str = "eval",
    group: str | None = None,
    **config: Any,
) -> TrainingRun:
    rows: list[dict[str, Any]] = []
    for frames, value in points:
        row = {"kind": kind, "frames": frames, "episodes": 50.0, "SR": value, "return": 100 * value}
        rows.append(row if group is None else {**row, "group": group})
    return TrainingRun(Path(name), name, {"world": {"name": "flat"}, **config}, rows)


def test_the_band_of_few_seeds_is_their_range_and_of_five_a_t_interval() -> None:
    values = [0.2, 0.4, 0.9]
    runs = [make_run(f"seed{i}", [(100.0, value), (200.0, 1.0)]) for i, value in enumerate(values)]
    band = training_band(runs, "eval", "SR")
    assert not band.is_interval and band.frames.tolist() == [100.0, 200.0]
    np.testing.assert_allclose([band.mean[0], band.low[0], band.high[0]], [0.5, 0.2, 0.9])
    more = [*values, 0.3, 0.7]
    band = training_band(
        [make_run(f"{i}", [(100.0, value)]) for i, value in enumerate(more)], "eval", "return"
    )
    low, high = stats.t.interval(0.95, 4, np.mean(more), stats.sem(more))
    assert band.is_interval
    np.testing.assert_allclose([band.mean[0], band.low[0], band.high[0]], [50, 100 * low, 100 * high])


def test_runs_are_interpolated_within_and_not_beyond_their_rows() -> None:
    first = make_run("a", [(0.0, 0.0), (200.0, 1.0)])
    second = make_run("b", [(100.0, 0.3)])
    band = training_band([first, second], "eval", "SR")
    np.testing.assert_allclose(band.mean, [0.0, 0.4, 1.0])
    assert band.runs.tolist() == [1, 2, 1]
    # One run alone has no spread.
    assert np.isnan(band.low).tolist() == [True, False, True]


def test_rows_without_a_value_are_left_out() -> None:
    band = training_band([make_run("a", [(0.0, np.nan), (50.0, 0.5)])], "eval", "SR")
    assert band.frames.tolist() == [50.0]
    assert not len(training_band([make_run("a", [(0.0, 0.1)])], "train", "SR").frames)


def test_trainings_in_other_worlds_are_apart() -> None:
    groups = {
        "a": [make_run("a", [(1.0, 0.0)])],
        "b": [make_run("b", [(1.0, 0.0)], world={"name": "island"})],
        "c": [make_run("c", [(1.0, 0.0)], world=None)],
    }
    assert {world: list(each) for world, each in by_world(groups).items()} == {
        "flat": ["a"],
        "island": ["b"],
        "unknown world": ["c"],
    }


def test_lines_and_bands_of_the_figure_are_those_of_the_runs() -> None:
    groups = {
        "one": [make_run(f"seed{i}", [(10.0, 0.1 * i), (20.0, 0.5)]) for i in range(3)],
        "two": [make_run("x", [(10.0, 1.0)])],
    }
    figure = draw_training_curves(groups)
    evaluation, training, returns, _ = figure.axes
    lines = {line.get_label(): line for line in evaluation.lines}
    np.testing.assert_allclose(lines["one"].get_ydata(), [0.1, 0.5])
    np.testing.assert_allclose(lines["two"].get_xydata(), [[10.0, 1.0]])
    np.testing.assert_allclose(returns.lines[0].get_ydata(), [10.0, 50.0])
    assert "50 episodes" in evaluation.get_title(loc="left") and "no rows" in training.get_title(loc="left")
    heights = evaluation.collections[0].get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((0.0, 0.5))
    assert "1 to 3 seeds" in figure.get_supxlabel() and "smallest to largest" in figure.get_supxlabel()


def test_groups_of_agents_and_missing_success_rates_have_rows_of_their_own() -> None:
    history = make_run("a", [(1.0, 0.5)], group="rovers").history
    history += [{**row, "group": "cars"} for row in history]
    for row in history[1:]:
        del row["SR"]
    figure = draw_training_curves({"a": [TrainingRun(Path("a"), "a", {}, history)]})
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
    assert labels == ["rovers: success rate", "rovers: return per episode", "cars: return per episode"]


def test_twelve_groups_and_none_can_be_drawn() -> None:
    groups = {f"runs/{i}": [make_run(f"{i}", [(1.0, i / 12), (2.0, 0.5)])] for i in range(12)}
    figure = draw_training_curves(groups)
    assert len(figure.axes[0].lines) == 12 and "one seed each" in figure.get_supxlabel()
    assert figure.legends[0].get_texts()[0].get_text() == "0"
    nothing = draw_training_curves({"a": [TrainingRun(Path("a"), "a", {}, [])]})
    assert "no episode has ended" in nothing.texts[0].get_text()
