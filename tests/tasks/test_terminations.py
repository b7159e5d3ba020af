"""Each termination term against flags worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_states import agents, state_of

from dune_rl.state import GroupState
from dune_rl.tasks import terminations
from dune_rl.tasks.terminations import Stuck

ALL = np.array([True])


def flags(term, group: GroupState, **parameters) -> list[bool]:
    values = term(state_of(group), group, **parameters)
    assert (values.shape, values.dtype) == (group.done.shape, bool)
    return values.tolist()


def test_a_goal_is_reached_below_its_distance() -> None:
    assert flags(terminations.goal_reached, agents(3, distance=[0.75, 0.7499, 0.0])) == [False, True, True]
    assert flags(terminations.goal_reached, agents(distance=0.6), distance_m=0.5) == [False]


@pytest.mark.parametrize(
    ("degrees", "over"),
    [((84.0, -84.0, 178.0), False), ((86.0, 0.0, 0.0), True), ((0.0, -86.0, 0.0), True)],
)
def test_roll_or_pitch_beyond_the_angle_is_flipped(degrees: tuple[float, ...], over: bool) -> None:
    assert flags(terminations.flipped, agents(roll_pitch_yaw=np.deg2rad(degrees))) == [over]


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), (0.0, 0.0, np.pi)])
def test_upside_down_is_flipped_in_any_convention(attitude: tuple[float, ...]) -> None:
    # Turned over by pitch and by roll, or by neither: the tilt is half a turn.
    assert flags(terminations.flipped, agents(roll_pitch_yaw=attitude, quaternion=(1.0, 0.0, 0.0, 0.0))) == [
        True
    ]


def test_the_angle_of_flipped_is_a_setting() -> None:
    group = agents(2, roll_pitch_yaw=np.deg2rad([[29.0, 0, 0], [31.0, 0, 0]]))
    assert flags(terminations.flipped, group, angle_deg=30.0) == [False, True]


@given(x=st.floats(-60.0, 60.0), y=st.floats(-30.0, 30.0), margin_m=st.floats(0.0, 5.0))
def test_out_of_world_is_outside_of_the_extent_less_the_margin(x: float, y: float, margin_m: float) -> None:
    inside = -50.0 + margin_m <= x <= 50.0 - margin_m and -20.0 + margin_m <= y <= 20.0 - margin_m
    group = agents(position=(x, y, 0.0))
    assert flags(terminations.out_of_world, group, margin_m=margin_m) == [not inside]


def test_a_collision_ends_where_it_begins() -> None:
    began = agents(3, touching=[True, True, False], new=[1, 0, 0])
    assert flags(terminations.contact, began) == [True, False, False]


def test_agents_of_a_scene_share_its_world() -> None:
    group = agents(4, count=2, position=[[0, 0, 0], [49.8, 0, 0], [0, -19.8, 0], [49.6, 19.6, 0]])
    assert flags(terminations.out_of_world, group) == [False, True, True, False]


def test_time_is_over_with_the_last_step() -> None:
    assert flags(terminations.time_limit, agents(step=1999)) == [False]
    assert flags(terminations.time_limit, agents(step=2000)) == [True]
    assert flags(terminations.time_limit, agents(step=20), max_steps=20) == [True]


# -- stuck -----------------------------------------------------------------------------------------


def at(*xs: float) -> GroupState:
    return agents(len(xs), position=[[x, 0.0, 0.0] for x in xs])


def test_an_agent_that_stays_is_stuck_after_so_many_steps() -> None:
    term = Stuck(1, distance_m=0.1, steps=3)
    term.reset(ALL, at(7.0))
    # It turns to and fro within 0.1 m of where it was.
    assert [flags(term, at(x)) for x in (7.05, 6.95, 7.1, 7.0)] == [[False], [False], [True], [True]]


def test_leaving_the_circle_begins_another() -> None:
    term = Stuck(1, distance_m=0.1, steps=3)
    term.reset(ALL, at(0.0))
    places = (0.05, 0.09, 0.12, 0.05, 0.2, 0.21)
    # At 0.12 the circle is left; from there 0.05 and 0.2 lie within the next one, for three steps.
    assert [flags(term, at(x))[0] for x in places] == [False, False, False, False, False, True]


def test_distance_counts_from_the_anchor_however_slow_the_way() -> None:
    term = Stuck(1, distance_m=0.1, steps=20)
    term.reset(ALL, at(0.0))
    # 0.01 m a step: each circle is left in its eleventh step.
    assert not any(flags(term, at(0.01 * step))[0] for step in range(1, 200))


def test_a_reset_begins_at_the_present_place_and_leaves_others_alone() -> None:
    term = Stuck(2, distance_m=0.1, steps=2)
    term.reset(np.array([True, True]), at(0.0, 0.0))
    assert flags(term, at(0.0, 0.0)) == [False, False]
    term.reset(np.array([True, False]), at(30.0, 99.0))
    assert flags(term, at(30.0, 0.0)) == [False, True]
    assert flags(term, at(30.0, 0.0)) == [True, True]
