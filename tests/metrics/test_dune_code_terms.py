"""The metric terms of the paper's published code on trajectories whose values are known by arithmetic."""

from typing import Any

import numpy as np
import pytest
from term_states import FixedScan, agents, state_of

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.terms.dune_code import (
    DuneCodeAttempts,
    DuneCodeClearance,
    DuneCodeGoalTime,
    DuneCodeRows,
    DuneCodeSmoothness,
    DuneCodeSpeed,
    dune_code_collisions,
    dune_code_vertical,
)
from dune_rl.metrics.terms.paper import time_on_uneven
from dune_rl.state import GroupState
from dune_rl.tasks.terminations import LongCollision

G = 9.81
EVERYONE = np.array([True])


def seen(nearest: Any, **changes: Any) -> GroupState:
    return agents(scanner=FixedScan(nearest), **changes)


def run(term: Any, steps: list[GroupState]) -> list[float]:
    """What a term gives in each step of one agent's episode."""
    term.reset(EVERYONE, agents())
    return [float(term(state_of(group), group)[0]) for group in steps]


def numbered(**columns: list[Any]) -> list[GroupState]:
    """Steps 1, 2, ... with a value of each column."""
    number = len(next(iter(columns.values())))
    return [
        agents(step=index + 1, **{name: values[index] for name, values in columns.items()})
        for index in range(number)
    ]


def test_a_collision_is_each_scan_within_the_distance() -> None:
    group = seen([0.16, 0.2, 0.21, np.nan], rows=4)
    assert dune_code_collisions(state_of(group), group).tolist() == [True, False, False, False]
    assert dune_code_collisions(state_of(group), group, distance_m=0.5).tolist() == [True, True, True, False]


def test_a_scan_that_is_not_measured_is_an_error() -> None:
    with pytest.raises(ConfigError, match="no scan is measured of rover"):
        dune_code_collisions(state_of(agents(scanner=None)), agents(scanner=None))


def test_vertical_acceleration_has_gravity_along_the_body() -> None:
    # On its side the rover feels gravity along y: what is left is its own acceleration.
    on_its_side = (np.sin(np.pi / 4), 0.0, 0.0, np.cos(np.pi / 4))
    group = agents(2, acceleration_b=[[0.0, 0.0, -2.0], [0.0, 0.0, -2.0]])
    np.testing.assert_allclose(dune_code_vertical(state_of(group), group), [G - 2.0] * 2)
    group = agents(quaternion=on_its_side, acceleration_b=(0.0, 0.0, -2.0))
    np.testing.assert_allclose(dune_code_vertical(state_of(group), group), [2.0])


def test_clearance_is_the_mean_of_the_last_scans_once_a_second() -> None:
    # Rows after 20 and 40 steps of 0.05 s. Scans without returns are no readings.
    nearest = [1.0] * 10 + [np.nan] * 10 + [4.0] * 20
    steps = [seen(value, step=index + 1) for index, value in enumerate(nearest)]
    values = run(DuneCodeClearance(1), steps)
    assert np.flatnonzero(~np.isnan(values)).tolist() == [19, 39]
    assert values[19] == pytest.approx(1.0)
    assert values[39] == pytest.approx((10 * 1.0 + 20 * 4.0) / 30)
    # Of the last 16 readings all are 4 m.
    assert run(DuneCodeClearance(1, readings=16), steps)[39] == pytest.approx(4.0)


def test_rows_without_any_return_have_no_clearance() -> None:
    steps = [seen(2.0 if step > 20 else np.nan, step=step) for step in range(1, 61)]
    assert np.nansum(run(DuneCodeClearance(1), steps)) == pytest.approx(2.0 + 2.0)
    assert sum(run(DuneCodeRows(1, of="clearance"), steps)) == 2
    assert sum(run(DuneCodeRows(1), steps)) == 3


def test_readings_are_of_the_present_episode() -> None:
    term = DuneCodeClearance(1)
    run(term, [seen(1.0, step=step) for step in range(1, 20)])
    assert run(term, [seen(3.0, step=step) for step in range(1, 21)])[19] == pytest.approx(3.0)


def test_smoothness_has_gravity_in_it() -> None:
    # (3, 0, 4 - 9.81) + (0, 0, 9.81) has length 5; the turn adds 0.5.
    steps = [
        agents(step=step, acceleration_b=(3.0, 0.0, 4.0 - G), angular_b=(0.0, 0.3, 0.4))
        for step in range(1, 21)
    ]
    values = run(DuneCodeSmoothness(1), steps)
    assert values[19] == pytest.approx(5.5) and np.isnan(values[:19]).all()
    resting = run(DuneCodeSmoothness(1), [agents(step=step) for step in range(1, 21)])
    assert resting[19] == pytest.approx(G)


def test_speed_is_everywhere_and_rough_where_the_acceleration_is_large() -> None:
    # Speeds 1 and 3 m/s for a second each; 15.01 m/s² are felt at the end of the second one alone.
    speeds = [(0.6, 0.0, 0.8)] * 20 + [(0.0, 3.0, 0.0)] * 20
    felt = [(0.0, 0.0, 0.0)] * 39 + [(0.0, 0.0, 15.01 - G)]
    steps = numbered(velocity_w=speeds, acceleration_b=felt)
    everywhere = run(DuneCodeSpeed(1), steps)
    assert [everywhere[19], everywhere[39]] == pytest.approx([1.0, 2.0])
    rough = run(DuneCodeSpeed(1, rough_mps2=15.0), steps)
    assert np.flatnonzero(~np.isnan(rough)).tolist() == [39] and rough[39] == pytest.approx(2.0)
    assert sum(run(DuneCodeRows(1, rough_mps2=15.0), steps)) == 1
    assert sum(run(DuneCodeRows(1, rough_mps2=15.1), steps)) == 0


def attempt(step: int, **endings: bool) -> GroupState:
    return agents(step=step, endings={"goal_reached": False, "stuck": False, **endings})


def test_attempts_count_if_they_are_long_enough() -> None:
    # Goals after 5, 10.05 and 15.1 s: the first attempt lasted 5 s, which is not more than 5 s.
    steps = [
        attempt(100, goal_reached=True),
        attempt(201, goal_reached=True),
        attempt(302, goal_reached=True),
        attempt(303),
        attempt(303 + 499, stuck=True),
    ]
    assert run(DuneCodeAttempts(1, outcome="reached"), steps) == [0, 1, 1, 0, 0]
    assert run(DuneCodeAttempts(1), steps) == [0, 1, 1, 0, 0]
    # One step more makes the failure longer than 25 s.
    steps[-1] = attempt(302 + 501, stuck=True)
    assert run(DuneCodeAttempts(1), steps) == [0, 1, 1, 0, 1]
    assert run(DuneCodeAttempts(1, failed_s=30.0), steps) == [0, 1, 1, 0, 0]
    np.testing.assert_allclose(run(DuneCodeGoalTime(1), steps), [5.0, 5.05, 5.05, 0.0, 0.0])


def test_attempts_are_of_the_present_episode() -> None:
    term = DuneCodeGoalTime(1)
    run(term, [attempt(100, goal_reached=True)])
    np.testing.assert_allclose(run(term, [attempt(40, goal_reached=True)]), [2.0])


def test_a_long_collision_is_more_scans_than_that() -> None:
    term = LongCollision(1, steps=3)
    near = [0.29, 0.3, 0.1, np.nan, 0.2, 0.2]
    assert run(term, [seen(value) for value in near]) == [0, 0, 0, 0, 0, 1]
    assert run(term, [seen(0.1)] * 4) == [0, 0, 0, 1]


def test_time_on_uneven_ground_is_that_of_vort() -> None:
    half = np.deg2rad([4.9, 5.1]) / 2
    group = agents(2, quaternion=np.stack([np.sin(half), 0 * half, 0 * half, np.cos(half)], axis=1))
    np.testing.assert_allclose(time_on_uneven(state_of(group), group), [0.0, 0.05])
    np.testing.assert_allclose(time_on_uneven(state_of(group), group, uneven_tilt_deg=2.0), [0.05, 0.05])
