"""Each reward term against values worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_states import agents, state_of

from dune_rl.state import GroupState
from dune_rl.tasks import rewards

DUNE_CODE = {"min_progress_m": 0.001, "signed": True, "heading_limit_deg": 72.0, "misaligned": -0.03}
angles = st.floats(-np.pi, np.pi)
lengths = st.floats(-10.0, 10.0)


def value(term, group: GroupState, **parameters) -> list[float]:
    values = term(state_of(group), group, **parameters)
    assert values.shape == group.done.shape
    return values.tolist()


# -- distance --------------------------------------------------------------------------------------


def test_progress_pays_for_its_metres() -> None:
    assert value(rewards.distance, agents(progress=0.04)) == pytest.approx([0.04 * 0.3])


@pytest.mark.parametrize("progress", [0.0, -0.04])
def test_without_progress_a_thousandth_is_lost(progress: float) -> None:
    assert value(rewards.distance, agents(progress=progress)) == [-0.001]


@pytest.mark.parametrize(
    ("bearing", "paid"),
    [(np.pi / 2, 0.04 * 0.3), (-np.pi / 2, 0.04 * 0.3), (np.pi / 2 + 1e-6, -0.001), (-3.0, -0.001)],
)
def test_progress_counts_while_the_goal_is_ahead(bearing: float, paid: float) -> None:
    assert value(rewards.distance, agents(progress=0.04, bearing=bearing)) == pytest.approx([paid])


@pytest.mark.parametrize(
    ("progress", "degrees", "paid"),
    [
        (0.04, 71.9, 0.012),
        (0.04, -72.1, -0.03),
        (-0.04, 71.9, -0.012),
        (-0.04, 80.0, -0.03),
        (0.0009, 0.0, -0.03),
        (-0.0009, 0.0, -0.03),
        (0.0011, 0.0, 0.00033),
    ],
)
def test_distance_as_the_published_code_has_it(progress: float, degrees: float, paid: float) -> None:
    group = agents(progress=progress, bearing=np.deg2rad(degrees))
    assert value(rewards.distance, group, **DUNE_CODE) == pytest.approx([paid])


@given(progress=lengths, bearing=angles, signed=st.booleans())
def test_distance_pays_progress_or_the_misaligned_reward(
    progress: float, bearing: float, signed: bool
) -> None:
    group = agents(progress=progress, bearing=bearing)
    moved = (group.goal.previous_distance - group.goal.distance)[0]
    (paid,) = value(rewards.distance, group, signed=signed, scale=2.0, misaligned=-0.5)
    ahead = abs(bearing) <= np.pi / 2
    expected = 2.0 * moved if ahead and (moved > 0.0 or (signed and moved < 0.0)) else -0.5
    assert paid == pytest.approx(expected)


# -- heading and velocity --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bearing", "share"),
    [(0.0, 1.0), (np.pi / 4, 0.5), (-np.pi / 4, 0.5), (3 * np.pi / 4, -0.5), (-np.pi, -1.0), (2.0, -0.27324)],
)
def test_heading_falls_from_one_to_minus_one(bearing: float, share: float) -> None:
    assert value(rewards.heading, agents(bearing=bearing)) == pytest.approx([0.01 * share], abs=1e-7)


def test_heading_is_nothing_across() -> None:
    assert value(rewards.heading, agents(2, bearing=[np.pi / 2, -np.pi / 2])) == pytest.approx([0.0, 0.0])


@given(bearing=angles, bonus=st.floats(0.0, 10.0))
def test_heading_is_a_line_of_the_angle(bearing: float, bonus: float) -> None:
    expected = bonus * (1.0 - 2.0 * abs(bearing) / np.pi)
    assert value(rewards.heading, agents(bearing=bearing), bonus=bonus) == pytest.approx([expected], abs=1e-9)


def test_velocity_pays_for_forward_speed_and_costs_turning() -> None:
    group = agents(2, velocity_b=[[0.8, 3.0, 3.0], [-0.4, 0.0, 0.0]], angular_b=[5.0, 5.0, -0.5])
    assert value(rewards.velocity, group) == pytest.approx([0.002, -0.001])
    got = value(rewards.velocity, group, turn_scale=0.0015)
    assert got == pytest.approx([0.002 - 0.0015 * 0.5, -0.001 - 0.0015 * 0.5])


# -- events ----------------------------------------------------------------------------------------


def test_collision_marks_what_is_close_or_touched() -> None:
    group = agents(4, clearance=[0.2, 0.1999, 0.0, 5.0], touching=[False, False, False, True])
    assert value(rewards.collision, group) == [False, True, True, True]
    assert value(rewards.collision, group, distance_m=0.0) == [False, False, False, True]


def test_contact_counts_collisions_that_begin() -> None:
    assert value(rewards.contact, agents(3, touching=True, new=[0, 1, 2], total=[4, 5, 6])) == [0, 1, 2]


def test_ended_by_is_the_termination_of_that_name() -> None:
    group = agents(2, endings={"stuck": [True, False], "flipped": [False, False]})
    assert value(rewards.ended_by, group, termination="stuck") == [True, False]
    assert value(rewards.ended_by, group, termination="flipped") == [False, False]
    assert value(rewards.ended_by, group, termination="another") == [False, False]


# -- walkers ---------------------------------------------------------------------------------------


def test_progress_is_the_metres_to_the_goal_that_were_made() -> None:
    assert value(rewards.progress, agents(2, progress=[0.05, -0.02])) == pytest.approx([0.05, -0.02])


def near_miss(*groups: GroupState, **parameters: float) -> np.ndarray:
    return rewards.near_miss(state_of(*groups), groups[0], **parameters)


@pytest.mark.parametrize(
    ("apart", "closeness"), [(2.0, 0.0), (1.2, 0.0), (0.6, 0.5), (0.3, 0.75), (0.0, 1.0), (-0.2, 1.0)]
)
def test_near_miss_grows_from_the_comfortable_distance_to_contact(apart: float, closeness: float) -> None:
    walker = agents(name="walker", position=(1.0, 2.0, 0.0), radius_m=0.25)
    rover = agents(name="rover", position=(1.0, 2.0 + 0.25 + 0.22 + apart, 9.0), radius_m=0.22)
    assert near_miss(walker, rover) == pytest.approx([closeness], abs=1e-12)


def test_near_miss_is_to_the_nearest_of_all_other_groups() -> None:
    # Two scenes of two walkers; walkers of the same group do not count.
    walkers = agents(
        4, count=2, name="walker", position=[[0, 0, 0], [0.1, 0, 0], [0, 0, 0], [5, 0, 0]], radius_m=0.1
    )
    rovers = agents(2, name="rover", position=[[0.7, 0, 0], [5, 0.5, 0]], radius_m=0.1)
    hounds = agents(
        4, count=2, name="hound", position=[[9, 9, 0], [0, -0.5, 0], [0, 0.4, 0], [9, 9, 0]], radius_m=0.0
    )
    # Gaps: hound 0.5 - 0.1; rover 0.6 - 0.2, hound hypot(0.1, 0.5) - 0.1; hound 0.4 - 0.1; rover 0.5 - 0.2.
    expected = [1 - 0.4, 1 - 0.4, 1 - 0.3, 1 - 0.3]
    assert near_miss(walkers, rovers, hounds, comfort_m=1.0) == pytest.approx(expected)


def test_near_miss_alone_is_nothing() -> None:
    assert near_miss(agents(4, count=2, name="walker")).tolist() == [0.0] * 4


# -- smoothness ------------------------------------------------------------------------------------


def test_smoothness_is_the_size_of_acceleration_and_turning() -> None:
    group = agents(acceleration_b=(3.0, 0.0, -4.0), angular_b=(0.0, 0.6, 0.8), velocity_b=(1.0, 0.0, 0.0))
    assert value(rewards.smoothness, group) == pytest.approx([5.0 + 1.0])
    assert value(rewards.smoothness, agents(velocity_b=(1.0, 0.0, 0.0))) == [0.0]
