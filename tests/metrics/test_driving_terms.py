"""Metrics of driving, on paths whose values are known by arithmetic."""

from typing import Any

import numpy as np
import pytest
from term_states import agents, state_of

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.terms import driving, paper
from dune_rl.metrics.terms.driving import Jerk, PathLength, Spl

EVERYONE = np.array([True])


def drive(
    term: Any, path: list[tuple[float, float]], goal: tuple[float, float] | None = None, **last: Any
) -> list[float]:
    """Values of a term with memory along a path of places; `last` changes the last state.

    The goal is the path's last place, unless it is given.
    """

    def left_m(place: tuple[float, float]) -> float:
        return float(np.hypot(*np.subtract(goal or path[-1], place)))

    term.reset(EVERYONE, agents(position=(*path[0], 0.0), distance=left_m(path[0])))
    values = []
    for place in path[1:]:
        changes = last if place is path[-1] else {}
        group = agents(position=(*place, 0.3), distance=left_m(place), **changes)
        values.append(float(term(state_of(group), group)[0]))
    return values


def test_the_path_is_as_long_as_its_parts() -> None:
    assert drive(PathLength(1), [(1.0, 1.0), (4.0, 5.0), (4.0, 5.0), (4.0, 3.0)]) == pytest.approx([5, 0, 2])


REACHED = {"endings": {"goal_reached": True}}
# Two sides of a square in place of its diagonal.
CORNER = [(0.0, 0.0), (3.0, 0.0), (3.0, 3.0)]


def test_spl_of_a_detour_is_the_ratio_of_the_ways() -> None:
    assert drive(Spl(1), CORNER, **REACHED) == pytest.approx([0.0, np.sqrt(2) / 2])


def test_spl_of_a_straight_way_is_one() -> None:
    assert drive(Spl(1), [(0.0, 0.0), (1.0, 1.0), (3.0, 3.0)], **REACHED)[-1] == pytest.approx(1.0)


def test_spl_counts_ways_to_where_the_goal_is_reached() -> None:
    goal = (3.0, 0.0)
    assert drive(Spl(1), [(0.0, 0.0), (2.5, 0.0)], goal, **REACHED)[-1] == pytest.approx(1.0)
    # 2.69 m: a detour, though shorter than the straight way to the goal itself.
    detour = drive(Spl(1), [(0.0, 0.0), (1.25, 0.5), (2.5, 0.0)], goal, **REACHED)[-1]
    assert detour == pytest.approx(2.5 / (2 * np.hypot(1.25, 0.5)))


def test_spl_without_a_goal_or_after_a_collision_is_nothing() -> None:
    assert drive(Spl(1), CORNER)[-1] == 0.0
    assert drive(Spl(1), CORNER, **REACHED, total=1)[-1] == 0.0


def test_spl_keeps_the_first_goal_and_forgets_it_at_a_reset() -> None:
    term = Spl(1)
    drive(term, CORNER, **REACHED)
    beyond = agents(position=(30.0, 3.0, 0.0), endings={"goal_reached": True})
    assert term(state_of(beyond), beyond)[0] == pytest.approx(np.sqrt(2) / 2)
    assert drive(term, CORNER)[-1] == 0.0


def test_roll_and_pitch_are_in_degrees_without_sign() -> None:
    group = agents(roll_pitch_yaw=np.deg2rad([-12.0, 7.0, 90.0]))
    assert driving.abs_roll(state_of(group), group)[0] == pytest.approx(12.0)
    assert driving.abs_pitch(state_of(group), group)[0] == pytest.approx(7.0)


def test_speed_is_horizontal() -> None:
    group = agents(velocity_w=(0.3, -0.4, 9.0))
    assert driving.ground_speed(state_of(group), group)[0] == pytest.approx(0.5)


def test_jerk_is_the_change_of_the_acceleration() -> None:
    term = Jerk(1)
    term.reset(EVERYONE, agents())
    first, second = agents(acceleration_b=(1.0, 0.0, 0.0)), agents(acceleration_b=(1.0, 0.3, 0.4))
    assert np.isnan(term(state_of(first), first)[0])
    # 0.5 m/s2 in 0.05 s.
    assert term(state_of(second), second)[0] == pytest.approx(10.0)
    term.reset(EVERYONE, agents())
    assert np.isnan(term(state_of(second), second)[0])


@pytest.mark.parametrize(
    ("turning", "forward", "slip"),
    [(10.0, 1.0, 0.0), (10.0, 0.5, 0.5), (5.0, 1.0, 0.5), (10.0, -1.0, 2.0), (0.5, 0.01, None)],
)
def test_slip_is_the_share_of_the_faster_of_both(turning: float, forward: float, slip: float | None) -> None:
    group = agents(velocity_b=(forward, 0.2, 0.0), joint_speed=turning, wheel_radius_m=0.1)
    expected = np.nan if slip is None else slip
    np.testing.assert_allclose(driving.slip(state_of(group), group), [expected], atol=1e-12)


def test_slip_is_that_of_wheels() -> None:
    group = agents()
    with pytest.raises(ConfigError, match="leave this metric out"):
        driving.slip(state_of(group), group)


def test_time_in_collision_is_that_of_the_touching_steps() -> None:
    group = agents(2, touching=[True, False])
    np.testing.assert_allclose(paper.time_in_collision(state_of(group), group), [0.05, 0.0])
