"""A task: what its terms come to together, and how its settings are given."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from published_tasks import DUNE_CODE, PAPER, begun, with_terms
from term_states import FixedScan, agents, state_of
from walker_groups import walker_groups

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.state import GroupState
from dune_rl.tasks.registry import REWARDS, TERMINATIONS
from dune_rl.tasks.task import Task, TaskConf, walking_task

UPSIDE_DOWN = (1.0, 0.0, 0.0, 0.0)
OUTSIDE = (49.9, 0.0, 0.0)
NEAR = FixedScan(0.29)


@pytest.fixture
def _users_terms_go() -> Iterator[None]:
    yield
    REWARDS._user_parts.clear()
    TERMINATIONS._user_parts.clear()


def step(task: Task, group: GroupState) -> np.ndarray:
    group = replace(group, endings=task.end(state_of(group), group).by_term)
    return task.reward(state_of(group), group)


def earned(group: GroupState, conf: TaskConf = PAPER) -> dict[str, float]:
    """What each reward term gives the first agent in one step, where it is anything."""
    task = begun(conf, group)
    reward = step(task, group)
    assert reward[0] == pytest.approx(task.reward_sums[0].sum())
    names = [name.removeprefix("reward/") for name in task.reward_names]
    return {name: value for name, value in zip(names, task.reward_sums[0], strict=True) if value}


def ended(group: GroupState, conf: TaskConf = PAPER) -> set[str]:
    """The terminations that are true of the first agent, and what follows of them."""
    task = begun(conf, group)
    end = task.end(state_of(group), group)
    assert set(end.by_term) == {*conf.terminations, "diverged"}
    follows = {"terminated": end.terminated, "truncated": end.truncated, "renews": end.renews}
    return {name for name, flags in {**end.by_term, **follows}.items() if flags[0]}


# -- point-goal navigation -------------------------------------------------------------------------


def test_the_paper_pays_distance_heading_and_velocity() -> None:
    group = agents(progress=0.04, velocity_b=(0.8, 0.0, 0.0))
    assert earned(group) == pytest.approx(
        {"distance": 1.5 * 0.04 * 0.3, "heading": 1.5 * 0.01, "velocity": 0.0025 * 0.8}
    )


@pytest.mark.parametrize("distance", [0.75, 0.7499])
def test_a_goal_pays_instead_of_navigation(distance: float) -> None:
    paid = earned(agents(distance=distance, velocity_b=(1.0, 0.0, 0.0)))
    if distance < 0.75:
        assert paid == {"goal": 100.0}
    else:
        assert paid.keys() == {"distance", "heading", "velocity"}


@pytest.mark.parametrize("clearance", [0.2, 0.1999, 0.0])
def test_a_close_obstacle_pays_instead_of_navigation(clearance: float) -> None:
    paid = earned(agents(clearance=clearance, velocity_b=(1.0, 0.0, 0.0)))
    if clearance < 0.2:
        assert paid == {"collision": -0.5}
    else:
        assert paid.keys() == {"distance", "heading", "velocity"}


def test_a_goal_beside_a_wall_is_a_goal() -> None:
    assert earned(agents(distance=0.5, clearance=0.1, touching=True)) == {"goal": 100.0}


def test_what_comes_instead_does_so_whatever_its_weight() -> None:
    conf = with_terms(PAPER, rewards={"goal": {"weight": 0.0}, "collision": {"weight": 0.0}})
    assert earned(agents(distance=0.5), conf) == {}
    assert earned(agents(clearance=0.1), conf) == {}


def test_a_collision_that_begins_costs_besides() -> None:
    group = agents(touching=True, new=1, total=1)
    assert earned(group, TaskConf()) == {"collision": -0.5, "contact": -10.0}
    assert earned(agents(touching=True, total=1), TaskConf()) == {"collision": -0.5}


def test_every_agent_earns_its_own() -> None:
    group = agents(3, distance=[0.1, 5.0, 5.0], clearance=[5.0, 0.1, 5.0], progress=[0.0, 0.0, 1.0])
    assert step(begun(PAPER, group), group) == pytest.approx([100.0, -0.5, 1.5 * 0.3 + 1.5 * 0.01])


@pytest.mark.parametrize(
    ("group", "expected"),
    [
        (agents(distance=0.499), {"goal": 100.0}),
        (agents(scanner=NEAR), {"collision": -0.5}),
        (agents(scanner=NEAR, quaternion=UPSIDE_DOWN), {"collision": -0.5, "flipped": -20.0}),
        (agents(scanner=NEAR, position=OUTSIDE), {"collision": -0.5, "out_of_world": -10.0}),
        # By the scan alone: what is lower, or nearer than its least range, costs nothing.
        (agents(clearance=0.0, scanner=FixedScan(0.31)), {"distance": -0.045}),
    ],
)
def test_events_of_the_published_code(group: GroupState, expected: dict[str, float]) -> None:
    assert earned(group, DUNE_CODE) == pytest.approx(expected)


def test_the_published_code_pays_for_being_stuck() -> None:
    group = agents(scanner=NEAR)
    task = begun(DUNE_CODE, group)
    got = [float(step(task, group)[0]) for _ in range(600)]
    assert got[:-1] == [-0.5] * 599
    assert got[-1] == -25.5


def test_a_time_out_of_the_published_code_is_an_end() -> None:
    assert ended(agents(step=2000), DUNE_CODE) == {"time_limit", "terminated"}
    assert ended(agents(step=2000)) == {"time_limit", "truncated"}


@pytest.mark.parametrize("option", ["paper", "dune_code", "point_goal"])
def test_options_are_what_they_were(option: str) -> None:
    expected = {"paper": PAPER, "dune_code": DUNE_CODE, "point_goal": TaskConf()}[option]
    assert compose_environment("flat", [f"task={option}"]).task == expected


# -- endings ---------------------------------------------------------------------------------------


def test_nothing_ends_in_the_open() -> None:
    assert ended(agents()) == set()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"distance": 0.749}, "goal_reached"),
        ({"roll_pitch_yaw": (1.6, 0.0, 0.0)}, "flipped"),
        ({"position": OUTSIDE}, "out_of_world"),
    ],
)
def test_what_terminates(changes: dict[str, Any], reason: str) -> None:
    assert ended(agents(**changes)) == {reason, "terminated"}


def test_touching_ends_nothing() -> None:
    assert ended(agents(touching=True, clearance=0.0, new=1, total=1)) == set()


def test_time_truncates_and_does_not_terminate() -> None:
    assert ended(agents(step=2000)) == {"time_limit", "truncated"}


def test_a_goal_in_the_last_step_is_a_goal() -> None:
    assert ended(agents(step=2000, distance=0.1)) == {"goal_reached", "terminated"}


def test_diverged_physics_truncates_whatever_else_seems_so() -> None:
    group = agents(
        diverged=True,
        distance=0.1,
        progress=0.1,
        position=OUTSIDE,
        step=2000,
        roll_pitch_yaw=(3.0, 0.0, 0.0),
    )
    assert ended(group) == {"diverged", "truncated"}
    assert earned(group).keys() == {"distance", "heading"}


def test_a_goal_may_be_renewed_instead_of_ending() -> None:
    on = with_terms(PAPER, terminations={"goal_reached": {"renew": True}})
    assert ended(agents(distance=0.1), on) == {"goal_reached", "renews"}
    assert ended(agents(distance=0.1, step=2000), on) == {"goal_reached", "time_limit", "truncated"}
    assert ended(agents(distance=0.1, position=OUTSIDE), on) == {"goal_reached", "out_of_world", "terminated"}
    assert ended(agents(distance=0.1, done=True), on) == {"goal_reached"}
    assert earned(agents(distance=0.1), on) == {"goal": 100.0}


@given(flags=arrays(bool, (7, 5)))
def test_who_ends_and_how(flags: np.ndarray) -> None:
    near, flipped, outside, late, diverged, done, renew = flags
    conf = with_terms(
        PAPER, terminations={"goal_reached": {"renew": bool(renew[0])}, "time_limit": {"max_steps": 9}}
    )
    group = agents(
        5,
        distance=np.where(near, 0.1, 9.0),
        roll_pitch_yaw=np.where(flipped, 2.0, 0.0)[:, None] * [1.0, 0.0, 0.0],
        position=np.where(outside, 99.0, 0.0)[:, None] * [1.0, 0.0, 0.0],
        diverged=diverged,
        done=done,
        step=9 if late[0] else 8,
    )
    end = begun(conf, group).end(state_of(group), group)
    ends = flipped | outside | (near & ~renew[0])
    np.testing.assert_array_equal(end.terminated, ends & ~diverged)
    np.testing.assert_array_equal(end.truncated, diverged | (~ends & late[0]))
    np.testing.assert_array_equal(end.renews, near & renew[0] & ~(ends | diverged | late[0] | done))


# -- sums ------------------------------------------------------------------------------------------


def test_sums_are_of_the_present_episode_and_end_with_it() -> None:
    group, over = agents(2, distance=0.1), agents(2, distance=0.1, done=[True, False])
    task = begun(PAPER, group)
    goal = task.reward_names.index("reward/goal")
    assert step(task, group).tolist() == [100.0, 100.0]
    assert step(task, over).tolist() == [0.0, 100.0]
    assert task.reward_sums[:, goal].tolist() == [100.0, 200.0]
    task.reset(np.array([False, True]), group)
    assert task.reward_sums[:, goal].tolist() == [100.0, 0.0]


@given(arrays(float, (4, 11), elements=st.floats(-1e6, 1e6)))
def test_a_row_s_sum_is_that_of_the_row_alone(values: np.ndarray) -> None:
    # Eleven terms, which numpy would add in pairs for some numbers of agents and in turn for others.
    conf = TaskConf(rewards={f"term_{k}": {"term": "progress", "weight": w} for k, w in enumerate(values[0])})
    group = agents(4, distance=0.0, progress=values[:, 0])
    together = step(begun(conf, group), group)
    for row in range(4):
        one = agents(distance=0.0, progress=values[row, 0])
        assert step(begun(conf, one), one).tobytes() == together[row : row + 1].tobytes()


def test_a_task_without_terms_earns_nothing() -> None:
    conf = TaskConf(rewards={}, terminations={})
    group = agents(2, distance=0.0)
    assert step(begun(conf, group), group).tolist() == [0.0, 0.0]
    assert ended(group, conf) == set()
    assert not begun(conf, group).has_ends


@pytest.mark.usefixtures("_users_terms_go")
@pytest.mark.parametrize("kind", ["reward", "termination"])
def test_an_error_in_a_term_says_which(kind: str) -> None:
    def odd(state: Any, group: GroupState) -> np.ndarray:
        raise ZeroDivisionError("no progress")

    getattr(dune_rl, f"register_{kind}")("odd")(odd)
    conf = with_terms(TaskConf(), **{f"{kind}s": {"odd_one": {"term": "odd"}}})
    with pytest.raises(ZeroDivisionError, match="no progress") as caught:
        earned(agents(2), conf)
    assert caught.value.__notes__ == [f"in the {kind} term 'odd_one'"]


# -- walkers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("apart", "cost"), [(2.0, 0.0), (0.6, -0.05), (0.0, -0.1), (0.3, -0.075)])
def test_a_walker_earns_progress_and_room(apart: float, cost: float) -> None:
    walker = agents(name="walker", progress=0.05, radius_m=0.25)
    rover = agents(position=(0.25 + apart, 0.0, 0.0))
    task = begun(walking_task(), walker)
    assert not task.has_ends
    assert task.reward(state_of(walker, rover), walker) == pytest.approx([0.05 + cost])


def test_a_walker_goes_on_to_its_next_way_point() -> None:
    assert ended(agents(distance=0.49), walking_task()) == {"goal_reached", "renews"}


@pytest.mark.slow(all_but=["20"])
@pytest.mark.parametrize("control_hz", [4, 20, 50])
def test_a_walker_earns_its_progress_at_any_control_rate(control_hz: int) -> None:
    path = {"controller": "external", "waypoints": [[-8.0, 8.0], [8.0, 8.0]], "start_distance_m": 0.0}
    conf = compose_environment(
        "flat", [f"physics.control_hz={control_hz}"], {"actors": walker_groups([path])}
    )
    simulation = make_simulation(conf, 1, seed=0)
    simulation.reset()
    simulation.group("walker").body.poses[0] = -6.0, 8.0, 0.0, 0.0, 0.0, 0.0
    ahead = {"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])}
    # The first step's progress is from where the episode began.
    simulation.step(ahead)
    for _ in range(3):
        assert simulation.step(ahead).groups["walker"].reward == pytest.approx(1.0 / control_hz, abs=1e-3)
    simulation.close()


# -- clean goals -----------------------------------------------------------------------------------


def clean_goal(**settings: Any) -> TaskConf:
    words = [f"task.{name}={value}" for name, value in settings.items()]
    return compose_environment("flat", ["task=clean_goal", *words]).task


def test_a_clean_goal_pays_progress_and_ends_at_the_first_collision() -> None:
    conf = clean_goal(**{"rewards.smoothness.weight": -0.01})
    driving = agents(progress=0.04, acceleration_b=(3.0, 0.0, 4.0), angular_b=(0.0, 0.0, 1.0))
    assert earned(driving, conf) == pytest.approx({"progress": 0.04, "smoothness": -0.06})
    assert ended(driving, conf) == set()
    met = agents(progress=0.04, touching=True, new=1)
    assert earned(met, conf) == pytest.approx({"progress": 0.04, "contact": -5.0})
    assert ended(met, conf) == {"contact", "terminated"}
    assert earned(agents(progress=0.04, distance=0.5), conf) == pytest.approx({"progress": 0.04, "goal": 5.0})
