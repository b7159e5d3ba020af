"""Metrics among other agents: gaps, times to contact and encounters, worked out by hand."""

from typing import Any

import numpy as np
import pytest
from simulations import act, put_walkers, started_simulation
from term_states import agents, state_of

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.terms import social
from dune_rl.metrics.terms.social import Encounters, NearMisses
from dune_rl.state import GroupState, State

EVERYONE = np.array([True])


def beside(*gaps: float, **rover: Any) -> tuple[State, GroupState]:
    """A rover at the origin, and a walker of radius 0.3 m at each of these gaps along x, ahead or behind."""
    places = [(np.sign(gap or 1.0) * (abs(gap) + 0.5), 0.0, 0.0) for gap in gaps]
    mine = agents(radius_m=0.2, **rover)
    walkers = agents(len(gaps), name="walker", count=len(gaps), position=places, radius_m=0.3)
    return state_of(mine, walkers), mine


def test_the_gap_is_that_of_the_nearest() -> None:
    assert social.actor_gap(*beside(3.0, -1.5, 9.0))[0] == pytest.approx(1.5)
    assert social.actor_gap(*beside(30.0))[0] == 12.0
    walker = agents(name="walker", position=(0.1, 0.0, 0.0), radius_m=0.3)
    rover = agents(radius_m=0.2)
    assert social.actor_gap(state_of(rover, walker), rover)[0] == 0.0


def test_only_named_groups_count_and_they_must_exist() -> None:
    state, rover = beside(1.0)
    assert social.actor_gap(state, rover, groups=("walker",))[0] == pytest.approx(1.0)
    assert social.actor_gap(state, rover, groups=("rover",))[0] == 12.0
    with pytest.raises(ConfigError, match=r"no group 'walkers' of agents; choose .*rover.*walker"):
        social.actor_gap(state, rover, groups=("walkers",))


def test_agents_of_one_group_meet_each_other_within_their_scene() -> None:
    # Two scenes of two agents each, 2 m and 5 m apart; scenes lie on the same ground.
    group = agents(4, count=2, position=[(0, 0, 0), (2, 0, 0), (0, 0, 0), (0, 5, 0)], radius_m=0.25)
    np.testing.assert_allclose(social.actor_gap(state_of(group), group), [1.5, 1.5, 4.5, 4.5])


def test_time_near_others_counts_the_steps() -> None:
    assert social.seconds_near(*beside(0.4))[0] == pytest.approx(0.05)
    assert social.seconds_near(*beside(0.6))[0] == 0.0
    assert social.seconds_near(*beside(0.6), within_m=1.2)[0] == pytest.approx(0.05)


def test_risk_grows_with_nearness() -> None:
    risks = [social.risk_seconds(*beside(gap))[0] for gap in (0.0, 0.25, 0.5, 1.0, 3.0)]
    np.testing.assert_allclose(risks, 0.05 * np.array([1.0, 0.75, 0.5, 0.0, 0.0]), atol=1e-9)


def moving(gap: float, speed: float, **rover: Any) -> tuple[State, GroupState]:
    """A rover that drives at `speed` along x towards a standing walker at this gap."""
    return beside(gap, velocity_w=(speed, 0.0, 0.0), **rover)


def near_misses(*steps: tuple[State, GroupState]) -> list[float]:
    term = NearMisses(1)
    term.reset(EVERYONE, agents())
    return [float(term(*step)[0]) for step in steps]


def test_a_near_miss_is_counted_when_it_begins() -> None:
    # 1.5 s, 0.75 s and 0.5 s away; then the rover stops, and drives again.
    steps = [moving(1.5, 1.0), moving(0.75, 1.0), moving(0.5, 1.0), moving(0.5, 0.0), moving(0.5, 1.0)]
    assert near_misses(*steps) == [False, True, False, False, True]


def test_no_near_miss_of_what_is_touched_passed_or_left_behind() -> None:
    assert near_misses(moving(0.5, 1.0, touching=True)) == [False]
    assert near_misses(moving(0.5, -1.0)) == [False]
    walker = agents(1, name="walker", position=(0.5, 3.0, 0.0), radius_m=0.3)
    rover = agents(radius_m=0.2, velocity_w=(1.0, 0.0, 0.0))
    assert near_misses((state_of(rover, walker), rover)) == [False]


def test_a_near_miss_that_ends_in_contact_is_a_collision() -> None:
    # 0.5 s away, on contact, bounced back, and driving on: only the last approach is without contact.
    steps = [moving(0.5, 1.0), moving(0.0, 1.0, touching=True), moving(0.1, -1.0), moving(0.5, 1.0)]
    assert near_misses(*steps) == [1.0, -1.0, 0.0, 1.0]
    # Further contact takes no more away, and what begins on contact is no near miss.
    steps = [moving(0.0, 1.0, touching=True), moving(0.1, 1.0), moving(0.0, 1.0, touching=True)]
    assert near_misses(*steps) == [0.0, 0.0, 0.0]


def test_both_velocities_count() -> None:
    rover = agents(radius_m=0.2, velocity_w=(1.0, 0.0, 0.0))
    walker = agents(1, name="walker", position=(2.0, 0.0, 0.0), radius_m=0.3, velocity_w=(-1.0, 0.0, 0.0))
    # 1.5 m at 2 m/s: 0.75 s.
    assert near_misses((state_of(rover, walker), rover)) == [True]
    fleeing = agents(1, name="walker", position=(0.9, 0.0, 0.0), radius_m=0.3, velocity_w=(1.0, 0.0, 0.0))
    assert near_misses((state_of(rover, fleeing), rover)) == [False]


def encounters(gaps: list[float], **limits: float) -> list[float]:
    term = Encounters(1, **limits)
    term.reset(EVERYONE, agents())
    return [float(term(*beside(gap))[0]) for gap in gaps]


def test_encounters_are_classed_by_their_smallest_gap() -> None:
    # One down to 0.6 m, one down to 0.9 m, and one that still goes on, at 0.3 m.
    gaps = [2.0, 1.0, 0.6, 1.0, 1.3, 0.9, 1.25, 0.3]
    assert encounters(gaps, least_m=0.5, most_m=0.8) == [0, 0, 1, 1, 1, 1, 1, 1]
    assert encounters(gaps, least_m=0.8) == [0, 1, 0, 0, 0, 1, 1, 1]
    assert encounters(gaps, most_m=0.5) == [0, 0, 0, 0, 0, 0, 0, 1]


def test_encounters_are_forgotten_at_a_reset() -> None:
    term = Encounters(1)
    assert term(*beside(0.5))[0] == 1.0
    term.reset(EVERYONE, agents())
    assert term(*beside(5.0))[0] == 0.0


def test_classes_of_encounters_lie_within_them() -> None:
    with pytest.raises(ConfigError, match="least_m < most_m <= within_m"):
        Encounters(1, least_m=0.5, most_m=1.5, within_m=1.2)


def test_gaps_and_near_misses_are_of_whole_bodies() -> None:
    # A car of 4.3 m by 1.8 m, 1 m behind a rover of 0.62 m, and beside it.
    car = {"body": "car", "count": 1, "controller": "external"}
    simulation = started_simulation("flat", actors={"car": car})
    rover = simulation.state.groups["rover"].motion
    start, yaw = rover.position_w[0, :2], float(rover.yaw[0])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    for offset, gap in ((-ahead * (0.31 + 1.0 + 2.15), 1.0), (left * (0.2215 + 1.0 + 0.9), 1.0)):
        put_walkers(simulation, [[*(start + offset), 0.0, yaw]], "car")
        act(simulation)
        state = simulation.state
        for mine, other in (("rover", "car"), ("car", "rover")):
            seen = social.actor_gap(state, state.groups[mine], groups=(other,))
            assert seen[0] == pytest.approx(gap, abs=0.02)
    simulation.close()


def test_the_ends_of_long_bodies_count_in_near_misses() -> None:
    # A rover drives at 1 m/s toward the nose of a car, whose middle is 2.6 m away: 0.5 m of gap.
    car = agents(name="car", position=(2.6, 0.0, 0.0), radius_m=0.9, half_length_m=1.9)
    rover = agents(radius_m=0.2, velocity_w=(1.0, 0.0, 0.0))
    assert near_misses((state_of(rover, car), rover)) == [True]
    short = agents(name="car", position=(2.6, 0.0, 0.0), radius_m=0.9, half_length_m=0.0)
    assert near_misses((state_of(rover, short), rover)) == [False]
