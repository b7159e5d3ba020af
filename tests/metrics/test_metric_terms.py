"""Each metric term against values worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from term_states import agents, state_of

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.terms import driving as energy
from dune_rl.metrics.terms import paper as terms
from dune_rl.metrics.terms.driving import BatteryRange, BatteryShare
from dune_rl.metrics.terms.paper import Success
from dune_rl.robots.settings import BatteryConf
from dune_rl.state import GroupState

vectors = arrays(float, (4, 3), elements=st.floats(-1e3, 1e3))
BATTERY = BatteryConf(capacity_wh=50.0, idle_w=7.2, efficiency=0.5)
REACHED, NOT = {"goal_reached": True}, {"goal_reached": False}


def value(term, group: GroupState, **parameters) -> list[float]:
    values = term(state_of(group), group, **parameters)
    assert values.shape == group.done.shape
    return values.tolist()


def test_ended_by_is_the_termination_of_that_name() -> None:
    group = agents(2, endings={"stuck": [True, False]})
    assert value(terms.ended_by, group, termination="stuck") == [True, False]
    assert value(terms.ended_by, group, termination="flipped") == [False, False]


def test_collisions_are_those_that_begin() -> None:
    assert value(terms.collisions, agents(2, new=[0, 2], total=[3, 2], touching=True)) == [0, 2]


def test_clearance_is_limited_and_nothing_on_contact() -> None:
    group = agents(4, clearance=[np.inf, 2.0, 30.0, 0.4], touching=[False, False, False, True])
    assert value(terms.clearance, group) == [12.0, 2.0, 12.0, 0.0]
    assert value(terms.clearance, group, max_m=1.5) == [1.5, 1.5, 1.5, 0.0]


def test_time_to_goal_is_that_of_a_step_that_reaches_it() -> None:
    group = agents(2, step=7, endings={"goal_reached": [True, False]})
    np.testing.assert_allclose(value(terms.time_to_goal, group), [0.35, np.nan])


@given(acceleration=vectors, turn=vectors)
def test_roughness_and_smoothness_are_sizes(acceleration: np.ndarray, turn: np.ndarray) -> None:
    group = agents(4, acceleration_b=acceleration, angular_b=turn)
    assert value(terms.vertical_roughness, group) == np.abs(acceleration[:, 2]).tolist()
    expected = np.linalg.norm(acceleration, axis=1) + np.linalg.norm(turn, axis=1)
    np.testing.assert_allclose(value(terms.smoothness, group), expected, rtol=1e-12)


def tilted(*degrees: float) -> np.ndarray:
    half = np.deg2rad(degrees) / 2
    return np.stack([np.sin(half), 0 * half, 0 * half, np.cos(half)], axis=1)


def test_vort_is_horizontal_speed_where_the_ground_is_uneven() -> None:
    group = agents(3, quaternion=tilted(4.9, 5.1, -30.0), velocity_w=[3.0, -4.0, 9.0])
    np.testing.assert_allclose(value(terms.vort, group), [np.nan, 5.0, 5.0])
    np.testing.assert_allclose(value(terms.vort, group, uneven_tilt_deg=10.0), [np.nan, np.nan, 5.0])


def success(*steps: dict) -> list[bool]:
    """Success after each of an agent's steps."""
    term = Success(1)
    term.reset(np.array([True]), agents())
    return [value(term, agents(**step))[0] for step in steps]


def test_success_is_a_goal_without_collision() -> None:
    assert success({"endings": NOT}, {"endings": REACHED}, {"endings": NOT}) == [False, True, True]
    # A collision spoils it, be it before, on arrival or after.
    assert success({"total": 1}, {"endings": REACHED, "total": 1}) == [False, False]
    assert success({"endings": REACHED, "total": 1, "new": 1}) == [False]
    assert success({"endings": REACHED}, {"total": 2, "new": 2}) == [True, False]


def test_success_is_of_the_present_episode() -> None:
    term, both = Success(2), np.array([True, True])
    term.reset(both, agents(2))
    value(term, agents(2, endings=REACHED))
    term.reset(np.array([True, False]), agents(2))
    assert value(term, agents(2, endings=NOT)) == [False, True]


# -- the battery -----------------------------------------------------------------------------------


def driven(work_j: float, speed: float = 0.0, **changes) -> GroupState:
    return agents(work_j=work_j, velocity_w=(0.6 * speed, -0.8 * speed, 5.0), battery=BATTERY, **changes)


def test_energy_is_the_idle_power_and_the_work_by_its_efficiency() -> None:
    # 7.2 W for 0.05 s are 0.36 J; 9 J of work take 18 J.
    assert value(energy.energy_wh, driven(9.0)) == pytest.approx([18.36 / 3600])
    assert value(energy.energy_wh, driven(np.nan, diverged=True)) == pytest.approx([0.36 / 3600])


def test_energy_that_is_not_measured_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"rover is not measured: set metrics\.energy=true"):
        value(energy.energy_wh, agents(battery=BATTERY))


def test_share_and_range_follow_from_energy_and_way() -> None:
    share, reach = BatteryShare(1), BatteryRange(1)
    for _ in range(2):
        for term in (share, reach):
            term.reset(np.array([True]), agents())
        # Two steps of 0.05 s at 2 and 4 m/s: 0.3 m for 2 x 18.36 J of the 180 kJ that there are.
        used = 0.0
        for speed in (2.0, 4.0):
            group = driven(9.0, speed)
            used += 18.36 / 180_000
            assert value(share, group) == pytest.approx([used])
            way = value(reach, group)
        assert way == pytest.approx([0.3e-3 / used])


def test_there_is_no_range_before_anything_is_drawn() -> None:
    reach = BatteryRange(1)
    reach.reset(np.array([True]), agents())
    idle = BatteryConf(capacity_wh=50.0, idle_w=0.0)
    assert np.isnan(value(reach, agents(work_j=0.0, battery=idle, velocity_w=(1.0, 0.0, 0.0))))
