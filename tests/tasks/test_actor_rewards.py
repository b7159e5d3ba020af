"""The reward terms of actors that learn, against values worked out by hand."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from states import STEP_S
from term_states import agents, state_of

from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.state import GroupState
from dune_rl.tasks import rewards
from dune_rl.tasks.actor_rewards import HitByRobot, RanIntoRobot, blocking, closing_in, robot_progress
from dune_rl.tasks.registry import REWARDS

walkers = partial(agents, name="walker", kind="person", radius_m=0.25)


def value(term, group: GroupState, *others: GroupState, **parameters) -> list[float]:
    values = term(state_of(group, *others), group, **parameters)
    assert values.shape == group.done.shape
    return values.tolist()


# -- the robot's way -------------------------------------------------------------------------------

# A robot at the origin whose goal is 10 m to the east.
ROBOT = agents(goal=(10.0, 0.0), progress=0.3)


@pytest.mark.parametrize(
    ("place", "share"),
    [
        ((1.0, 0.0), 0.75),
        ((1.0, 0.5), 0.75 * 0.5),
        ((1.0, -0.5), 0.75 * 0.5),
        ((3.0, 0.0), 0.25),
        ((1.0, 1.1), 0.0),
        ((-1.0, 0.0), 0.0),
        ((5.0, 0.0), 0.0),
    ],
)
def test_who_is_right_before_the_robot_blocks_it_most(place, share) -> None:
    group = walkers(position=(*place, 0.0))
    assert value(blocking, group, ROBOT, ahead_m=4.0, width_m=1.0) == pytest.approx([share])


def test_nobody_blocks_beyond_the_goal() -> None:
    near = agents(goal=(2.0, 0.0))
    assert value(blocking, walkers(position=(2.1, 0.0, 0.0)), near) == [0.0]
    assert value(blocking, walkers(position=(1.9, 0.0, 0.0)), near)[0] > 0.0


def test_moving_to_the_place_ahead_of_the_robot_pays_its_metres() -> None:
    # The place is (2, 0); the first walks straight to it, the second from it, the third past it, at 1 m/s.
    group = walkers(
        3,
        count=3,
        position=[(2.0, 3.0, 0.0), (6.0, 0.0, 0.0), (2.0, -3.0, 0.0)],
        velocity_w=[(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)],
    )
    assert value(closing_in, group, ROBOT, ahead_m=2.0) == pytest.approx([STEP_S, -STEP_S, 0.0], abs=1e-12)
    # A robot that comes nearer by itself earns the actor nothing.
    still = walkers(position=(5.0, 0.0, 0.0))
    assert value(closing_in, still, agents(goal=(10.0, 0.0), velocity_w=(1.0, 0.0, 0.0))) == [0.0]


def test_the_nearest_robot_counts_unless_it_is_done() -> None:
    two = partial(
        agents,
        2,
        count=2,
        position=[(0.0, 0.0, 0.0), (20.0, 0.0, 0.0)],
        goal=[(10.0, 0.0), (30.0, 0.0)],
        progress=[0.3, -0.1],
    )
    group = walkers(position=(1.0, 0.0, 0.0))
    assert value(robot_progress, group, two()) == pytest.approx([0.3])
    assert value(robot_progress, group, two(done=[True, False])) == pytest.approx([-0.1])
    assert value(robot_progress, group, two(done=True)) == [0.0]
    assert value(blocking, group, two(done=True)) == value(closing_in, group, two(done=True)) == [0.0]


def test_scenes_are_apart_and_other_actors_are_no_robots() -> None:
    # Two scenes of two walkers; the robots have their goals to the east and to the west.
    robots = agents(2, goal=[(10.0, 0.0), (-10.0, 0.0)], progress=[0.1, 0.2])
    group = walkers(4, count=2, position=[(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)] * 2)
    cows = agents(2, name="cow", kind="cow", progress=5.0, goal=(1.0, 1.0))
    assert value(blocking, group, robots, cows) == pytest.approx([0.75, 0.0, 0.0, 0.75])
    assert value(robot_progress, group, robots, cows) == pytest.approx([0.1, 0.1, 0.2, 0.2])


def test_groups_are_chosen_by_name_and_may_be_none() -> None:
    scout = agents(name="scout", position=(3.0, 0.0, 0.0), goal=(9.0, 0.0), progress=0.7)
    group = walkers(position=(2.0, 0.0, 0.0))
    assert value(robot_progress, group, ROBOT, scout) == pytest.approx([0.7])
    assert value(robot_progress, group, ROBOT, scout, groups=("rover",)) == pytest.approx([0.3])
    for term in (blocking, closing_in, robot_progress, RanIntoRobot(1), HitByRobot(1)):
        assert value(term, group) == [0.0]
    with pytest.raises(ConfigError, match="no group 'dog' of agents; choose walker or rover"):
        value(blocking, group, ROBOT, groups=("dog",))


# -- who touched whom ------------------------------------------------------------------------------


def collision(
    own: float, robot: float, *, in_its_step: tuple[float, float] = (0.0, 0.0), make_term=RanIntoRobot
) -> float:
    """The term where a walker east of the robot went at it with `own` m/s, and the robot with `robot`."""
    term = make_term(1)
    first = walkers(position=(0.6, 0.0, 0.0), velocity_w=(-own, 0.0, 0.0))
    term.reset(np.ones(1, bool), first)
    assert value(term, first, agents(velocity_w=(robot, 0.0, 0.0))) == [0.0]
    then = walkers(position=(0.5, 0.0, 0.0), velocity_w=(-in_its_step[0], 0.0, 0.0), new=1, touching=True)
    return value(term, then, agents(velocity_w=(in_its_step[1], 0.0, 0.0)))[0]


def test_the_one_that_moved_into_the_other_is_charged() -> None:
    assert collision(own=1.0, robot=0.3) == 1.0
    assert collision(own=0.3, robot=1.0) == 0.0
    assert collision(own=0.0, robot=0.0) == 0.0
    # Away from the robot, or hardly at all.
    assert collision(own=-1.0, robot=-2.0) == 0.0
    assert collision(own=0.02, robot=0.0) == 0.0
    # What begins to move in the very step counts, and a robot that was stopped by the contact did move.
    assert collision(own=0.0, robot=0.0, in_its_step=(1.0, 0.0)) == 1.0
    assert collision(own=0.5, robot=0.8, in_its_step=(0.5, 0.0)) == 0.0


def test_a_robot_that_alone_moved_into_the_actor_hit_it() -> None:
    hit = partial(collision, make_term=HitByRobot)
    assert hit(own=0.0, robot=0.3) == 1.0
    # Across its way, or ahead of it.
    assert hit(own=-0.5, robot=0.8) == 1.0
    # Stopped by the contact.
    assert hit(own=0.0, robot=0.8, in_its_step=(0.0, 0.0)) == 1.0
    # Both went at each other, or neither; or the actor began to in the very step.
    assert hit(own=0.3, robot=1.0) == 0.0
    assert hit(own=0.0, robot=0.02) == 0.0
    assert hit(own=0.0, robot=0.3, in_its_step=(0.3, 0.3)) == 0.0


def test_a_hit_counts_once() -> None:
    term = HitByRobot(1)
    robot, touched = (
        agents(velocity_w=(0.5, 0.0, 0.0)),
        partial(walkers, position=(0.5, 0.0, 0.0), touching=True),
    )
    assert value(term, touched(new=1), robot) == [1.0]
    assert value(term, touched(), robot) == [0.0]
    assert value(
        HitByRobot(1, groups=("leo",)), touched(new=1), robot, agents(name="leo", position=(8.0, 0.0, 0.0))
    ) == [0.0]


def test_who_goes_on_to_push_pays_in_each_step() -> None:
    term = RanIntoRobot(1, pushing=0.25)
    moving = {"position": (0.5, 0.0, 0.0), "velocity_w": (-0.5, 0.0, 0.0), "touching": True}
    assert value(term, walkers(**moving, new=1), agents()) == [1.0]
    assert value(term, walkers(**moving), agents()) == [0.25]
    # Held back by the robot: the last step's speed counts once more, and then no longer.
    held = {**moving, "velocity_w": (0.0, 0.0, 0.0)}
    assert value(term, walkers(**held), agents()) == [0.25]
    assert value(term, walkers(**held), agents()) == [0.0]
    assert value(term, walkers(**moving), agents(velocity_w=(0.8, 0.0, 0.0))) == [0.0]


def test_a_new_episode_forgets_who_moved() -> None:
    term, moving = RanIntoRobot(2), walkers(2, position=(0.6, 0.0, 0.0), velocity_w=(-1.0, 0.0, 0.0))
    robots = agents(2)
    value(term, moving, robots)
    term.reset(np.array([True, False]), moving)
    touching = walkers(2, position=(0.5, 0.0, 0.0), new=1, touching=True)
    assert value(term, touching, robots) == [0.0, 1.0]


def test_it_is_the_nearest_robot_that_was_touched() -> None:
    robots = agents(
        2, count=2, position=[(0.0, 0.0, 0.0), (0.0, 9.0, 0.0)], velocity_w=[(2.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    )
    group = walkers(position=(0.5, 0.0, 0.0), velocity_w=(-1.0, 0.0, 0.0), new=1, touching=True)
    assert value(RanIntoRobot(1), group, robots) == [0.0]


def test_a_touched_robot_of_another_group_charges_nobody() -> None:
    group = walkers(position=(0.5, 0.0, 0.0), velocity_w=(1.0, 0.0, 0.0), new=1, touching=True)
    rover, leo = agents(position=(8.0, 0.0, 0.0)), agents(name="leo")
    assert value(RanIntoRobot(1, groups=("rover",)), group, rover, leo) == [0.0]
    # It walks at the rover, and touches that.
    near = agents(position=(1.0, 0.0, 0.0))
    away = agents(name="leo", position=(-8.0, 0.0, 0.0))
    assert value(RanIntoRobot(1, groups=("rover",)), group, near, away) == [1.0]


def test_a_robot_whose_episode_is_over_can_still_be_run_into() -> None:
    group = walkers(position=(0.5, 0.0, 0.0), velocity_w=(-1.0, 0.0, 0.0), new=1, touching=True)
    assert value(RanIntoRobot(1), group, agents(done=True)) == [1.0]


def test_an_actor_that_is_a_robot_is_not_charged_for_walls() -> None:
    """It hits something while it drives at a robot 3 m away: nothing, or that robot."""
    scout = agents(name="scout", position=(3.0, 0.0, 0.0), velocity_w=(-1.0, 0.0, 0.0), new=1, touching=True)
    assert value(RanIntoRobot(1), scout, agents()) == [0.0]
    contacts = replace(scout.contacts, new_by_kind={"robot": np.array([1]), "static": np.array([1])})
    assert value(RanIntoRobot(1), replace(scout, contacts=contacts), agents()) == [1.0]


@pytest.mark.parametrize("name", ["dog", "walker"])
def test_rewards_name_other_groups_of_robots(name: str) -> None:
    words = ["actors.walker.task=adversarial", f"actors.walker.task.rewards.hit_by_robot.groups=[{name}]"]
    told = (
        rf"actors\.walker\.task\.rewards\.hit_by_robot\.groups: there is no other group of robots '{name}'; "
        "choose rover"
    )
    with pytest.raises(ConfigError, match=told):
        compose_environment("flat", words, {"actors": "learning_walkers"})
    words[1] = words[1].replace(f"[{name}]", "[rover]")
    compose_environment("flat", words, {"actors": "learning_walkers"})


# -- keeping clear ---------------------------------------------------------------------------------


def test_a_near_miss_of_the_own_group_counts_if_told_so() -> None:
    # 1 m between centres, 0.5 m between surfaces, in the first scene; 5 m in the second.
    group = walkers(4, count=2, position=[(0, 0, 0), (1, 0, 0), (0, 0, 0), (5, 0, 0)])
    far = agents(2, position=(50.0, 0.0, 0.0))
    assert value(rewards.near_miss, group, far, comfort_m=1.0) == [0.0] * 4
    assert value(rewards.near_miss, group, far, comfort_m=1.0, own_group=True) == [0.5, 0.5, 0.0, 0.0]
    alone = walkers(position=(0.0, 0.0, 0.0))
    assert value(rewards.near_miss, alone, own_group=True) == [0.0]


# -- the options -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "terms"),
    [
        ("cooperative", ["progress", "near_miss", "goal", "contact"]),
        ("indifferent", ["progress", "goal"]),
        ("adversarial", ["closing_in", "blocking", "robot_progress", "ran_into_robot", "hit_by_robot"]),
    ],
)
def test_the_tasks_are_options_of_external_actors(task: str, terms: list[str]) -> None:
    settings = {"actors": "learning_walkers"}
    conf = compose_environment("flat", [f"actors.walker.task={task}"], settings)
    walker = conf.groups[1]
    assert walker.is_external and walker.count == 4 and walker.task is not None
    assert list(walker.task.rewards) == terms
    assert set(terms) <= set(REWARDS.names()) | {"goal"}
    assert walker.sensors is not None
    assert list(walker.sensors) == ["goal", "neighbours", "lidar", "velocity"]
