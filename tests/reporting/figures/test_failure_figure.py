"""The gallery of failures: what is chosen, how episodes are run again, and what stands in for pictures."""

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from report_runs import methods_of

from dune_rl import evaluate
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.figures.failure_replay import replay_failures
from dune_rl.reporting.figures.failures import choose_failures, draw_failures, show_failures
from dune_rl.reporting.inputs import EvaluationRun
from dune_rl.reporting.rows import StepTable

TEXT = {"policy", "set", "world", "engine", "agent"}


def make_method(make_rows: Callable, name: str, **ends: list[int]) -> EvaluatedPolicy:
    """A method of ten episodes; `ends` has the numbers of those with each failure."""
    rows = [
        {**row, "collisions": 0.0} | {kind: float(index in numbers) for kind, numbers in ends.items()}
        for index, row in enumerate(make_rows(10, 0))
    ]
    run = EvaluationRun(Path("none"), "none", {}, {}, rows)
    return EvaluatedPolicy(name, name, rows, [run], "a")


def read_table(file: Path) -> list[dict[str, Any]]:
    rows = csv.DictReader(file.read_text().splitlines())
    return [
        {key: value if key in TEXT else float(value) if value else math.nan for key, value in row.items()}
        for row in rows
    ]


def read_evaluation(path: Path) -> EvaluationRun:
    config = yaml.safe_load((path / "config.yaml").read_text())
    provenance = json.loads((path / "provenance.json").read_text())
    steps = path / "steps.csv"
    return EvaluationRun(
        path, path.name, config, provenance, read_table(path / "episodes.csv"),
        StepTable.read(steps) if steps.exists() else StepTable(),
    )  # fmt: skip


def test_some_of_each_kind_are_chosen_from_other_episodes(make_rows: Callable) -> None:
    method = make_method(make_rows, "m", collisions=[0, 1, 2], stuck=[0, 3], timeout=[5])
    chosen = [(one.kind, one.key[0]) for one in choose_failures([method])]
    assert chosen == [("collision", 1), ("stuck", 0), ("timeout", 5)]
    more = [(one.kind, one.key[0]) for one in choose_failures([method], each=2)]
    assert more == [("collision", 1), ("collision", 2), ("stuck", 0), ("stuck", 3), ("timeout", 5)]


def test_the_number_is_bounded_and_shared_by_all_methods(make_rows: Callable) -> None:
    many = [make_method(make_rows, f"m{i}", collisions=[0], stuck=[1], flipped=[2]) for i in range(12)]
    chosen = choose_failures(many, most=14)
    assert len(chosen) == 14 and {one.method.name for one in chosen} == {f"m{i}" for i in range(12)}
    assert choose_failures([make_method(make_rows, "perfect")]) == []


def test_without_the_folder_and_steps_failures_are_left_out_with_a_reason(make_rows: Callable) -> None:
    calls: list[int] = []
    method = make_method(make_rows, "m", collisions=[0], stuck=[3])
    first, second = failures = show_failures(choose_failures([method]), calls.append)
    assert not first.is_shown and not second.is_shown and calls == [0, 1, 2]
    assert [(one.kind, one.count) for one in failures] == [("collision", 1), ("stuck", 1)]
    assert "episode 0 (collision)" in first.reason and "episode 3 (stuck)" in second.reason
    assert "config.yaml" in first.reason and "no steps" in first.reason
    assert "no failure to show" in draw_failures(failures).texts[0].get_text()
    assert "no failure to show" in draw_failures([]).texts[0].get_text()


@pytest.fixture
def evaluated(call: Callable[..., int], folder: Path) -> EvaluationRun:
    """Two short episodes that run out of time."""
    words = ["policy=go_to_goal", "+world=flat", "actors=none", "episodes=2", "steps=3", "out=results"]
    assert call(evaluate.main, *words, "task.terminations.time_limit.max_steps=30") == 0
    return read_evaluation(folder / "results")


@pytest.mark.slow
def test_pictures_are_of_the_seconds_before_the_same_failure(evaluated: EvaluationRun) -> None:
    (shown,) = show_failures(choose_failures(methods_of(evaluated)), lambda done: None)
    assert (shown.kind, shown.key[0], shown.reason, shown.track) == ("timeout", 0, "", None)
    assert shown.replay is not None and shown.replay.time_s == pytest.approx(1.5)
    # The episode lasts 1.5 s: there is nothing 3 or 2 s before its end.
    np.testing.assert_allclose(shown.replay.before_s, [1.0, 0.0])
    early, late = shown.replay.pictures
    assert early.shape == (240, 320, 3) and early.dtype == np.uint8 and (early != late).any()
    figure = draw_failures([shown])
    pictures = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title(loc="left") for axes in pictures] == ["1.0 s before", "the failure"]
    assert (np.asarray(pictures[1].images[0].get_array()) == late).all()
    label = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert "go_to_goal" in label and "out of time" in label and "episode 0" in label and "one of 2" in label


@pytest.mark.slow
def test_an_episode_that_comes_out_otherwise_is_shown_from_its_steps(evaluated: EvaluationRun) -> None:
    for row in evaluated.episodes:
        row["steps"] = 29.0
    (shown,) = show_failures(choose_failures(methods_of(evaluated)), lambda done: None)
    assert shown.replay is None and "came out differently" in shown.reason
    assert shown.track is not None
    figure = draw_failures([shown])
    (panel,) = figure.axes
    assert "came out differently" in panel.get_xlabel().replace("\n", " ")
    assert "out of time, episode 0" in panel.get_title(loc="left")
    assert "last 20 s on the map" in panel.get_title(loc="left")
    many = draw_failures([shown] * 6)
    assert len(many.axes) == 6


def test_functions_of_users_and_changed_weights_are_not_run(evaluated: EvaluationRun) -> None:
    config = yaml.safe_load((evaluated.path / "config.yaml").read_text())
    (method,) = methods_of(evaluated)
    (wanted,) = choose_failures([method])
    provenance = json.loads((evaluated.path / "provenance.json").read_text())
    config["policy"] = ["os:getcwd"]
    (evaluated.path / "config.yaml").write_text(yaml.safe_dump(config))
    other = EvaluatedPolicy("getcwd", "getcwd", method.rows, method.runs, method.cases)
    provenance["policies"] = [{"location": "os:getcwd", "sha256": None}]
    (evaluated.path / "provenance.json").write_text(json.dumps(provenance))
    wanted.method = other
    replay_failures([wanted], (64, 64))
    assert "which reports do not run" in wanted.reason
    provenance["policies"][0]["sha256"] = "0" * 64
    (evaluated.path / "provenance.json").write_text(json.dumps(provenance))
    replay_failures([wanted], (64, 64))
    assert "other weights" in wanted.reason
    wanted.method = method
    replay_failures([wanted], (64, 64))
    assert "not among those" in wanted.reason
