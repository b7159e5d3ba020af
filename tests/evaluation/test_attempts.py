"""Attempts at goals, and the best of the published code's sliding windows, against hand-made values."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dune_rl.evaluation.protocols.attempts import (
    Attempt,
    AttemptRecorder,
    best_window_rate,
    cut_attempts,
    join_attempts,
)

# An episode with goals after 10 and 14 s that gets stuck at 40 s, with a collision at 30 s.
EPISODE = [Attempt(0.0, 10.0, "reached"), Attempt(10.0, 14.0, "reached"), Attempt(14.0, 40.0, "failed", 30.0)]


def test_attempts_of_episodes_follow_each_other() -> None:
    joined = join_attempts([(40.0, EPISODE), (12.0, EPISODE[:1])])
    assert joined[:3] == EPISODE
    assert joined[3:] == [Attempt(40.0, 50.0, "reached")]
    assert EPISODE[2].later(5.0) == Attempt(19.0, 45.0, "failed", 35.0)


def test_an_attempt_under_way_is_cut_with_its_run() -> None:
    assert cut_attempts(EPISODE, 14.0) == EPISODE[:2]
    assert cut_attempts(EPISODE, 12.0) == [EPISODE[0], Attempt(10.0, 12.0, "cut")]
    assert cut_attempts(EPISODE, 35.0) == [*EPISODE[:2], Attempt(14.0, 35.0, "cut", 30.0)]
    assert cut_attempts(EPISODE, 20.0)[2] == Attempt(14.0, 20.0, "cut")


def test_a_window_counts_what_the_script_counts() -> None:
    # One window: a success of 10 s and a failure of 26 s; the goal after 4 s does not count. The log goes on.
    log = [*EPISODE, Attempt(40.0, 41.0, "failed")]
    assert best_window_rate(log) == pytest.approx(1 / 2)
    # A failure of 25 s does not count either.
    short = [*EPISODE[:2], Attempt(14.0, 39.0, "failed"), Attempt(39.0, 40.0, "failed")]
    assert best_window_rate(short) == pytest.approx(1.0)


def test_the_last_attempt_of_a_log_counts_by_its_collision_alone() -> None:
    assert best_window_rate(EPISODE) == pytest.approx(1 / 2)
    assert best_window_rate([*EPISODE[:2], Attempt(14.0, 40.0, "failed")]) == pytest.approx(1.0)
    # It has not happened yet when a window of 29 s ends, and those that begin later see no success.
    assert best_window_rate(EPISODE, window_s=29.0) == pytest.approx(1.0)
    cut = [*EPISODE[:2], Attempt(14.0, 40.0, "cut")]
    assert best_window_rate(cut) == pytest.approx(1.0)


def test_the_best_window_flatters() -> None:
    # Ten minutes of failures, then ten of successes: the rate of all is 1/2, of the best window 1.
    failures = [Attempt(begin, begin + 30.0, "failed") for begin in np.arange(0.0, 600.0, 30.0)]
    successes = [Attempt(begin, begin + 30.0, "reached") for begin in np.arange(600.0, 1200.0, 30.0)]
    assert best_window_rate([*failures, *successes]) == pytest.approx(1.0)
    assert best_window_rate(failures) == pytest.approx(0.0)
    # Mixed evenly, windows that end within the log have half, and one at its end has a single success.
    mixed = [one for pair in zip(successes, failures, strict=True) for one in pair]
    even = [Attempt(30.0 * i, 30.0 * i + 30.0, one.outcome) for i, one in enumerate(mixed)]
    assert best_window_rate(even) == pytest.approx(1.0)
    assert best_window_rate(even, whole=True) == pytest.approx(1 / 2, abs=0.03)
    assert best_window_rate(even[:4], whole=True) == pytest.approx(2 / 3)


def test_nothing_was_attempted() -> None:
    assert math.isnan(best_window_rate([]))


def test_an_attempt_has_no_late_collision_of_the_one_before() -> None:
    group = SimpleNamespace(episode=SimpleNamespace(step_s=1.0, steps=np.zeros(1)))
    group.ended_by = lambda _: group.episode.steps == 8
    simulation: Any = SimpleNamespace(
        num_scenes=1, steps=np.zeros(1), state=SimpleNamespace(groups={"rover": group})
    )
    recorder = AttemptRecorder(cast(Any, simulation), "rover")
    recorder.begin()
    for step in range(1, 13):
        group.episode.steps, group.nearest_return = np.array([step]), np.array([0.2 if step == 5 else 2.0])
        recorder.step()
    assert recorder.finish(0) == [Attempt(0.0, 8.0, "reached", 5.0), Attempt(8.0, 12.0, "failed")]
