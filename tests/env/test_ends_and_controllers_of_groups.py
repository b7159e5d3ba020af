"""How the episodes of agent groups end, groups of their own, and groups that drive themselves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from agent_teams import EXPLICIT, SCENES, SHORT, TWO_STEPS, simulation
from simulations import (
    act,
    environment_conf,
    goals_w,
    metric,
    metrics,
    motion_of_group,
    observation,
    outcome,
    rest,
    set_goal,
    started_simulation,
    state_of_group,
)

import dune_rl
from dune_rl.config.build import build_world, group_setups
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.controllers import PolicyController
from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.physics.interface import OWN_ENGINES

every_engine = pytest.mark.parametrize("engine", OWN_ENGINES)


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=OWN_ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


# -- ends ------------------------------------------------------------------------------------------


def test_members_that_are_done_wait_for_the_others() -> None:
    core = simulation("team")
    set_goal(core, 0, motion_of_group(core).position_w[0, :2])
    step = act(core)
    assert outcome(step).terminated.tolist() == [True, False, False]
    assert not step.done[0], "the others still have to arrive"
    assert outcome(step).reward[0] > 50.0
    final = metrics(core)[0].copy()
    for _ in range(5):
        later = outcome(act(core, [1.0, 1.0]))
    assert later.reward[0] == 0.0
    assert later.terminated[0], "its end stays set"
    assert motion_of_group(core).velocity_b[0, 0] < 0.3, "it stands, whatever its action"
    assert motion_of_group(core).velocity_b[1, 0] > 0.3
    np.testing.assert_array_equal(metrics(core)[0], final)
    core.close()


def test_in_pettingzoo_all_agents_end_in_the_last_step_each_as_it_did() -> None:
    made = dune_rl.parallel_env("flat", task=SHORT, **SCENES["team"])
    made.reset(seed=0)
    core = made.simulation
    set_goal(core, 1, motion_of_group(core).position_w[1, :2])
    idle = {agent: np.zeros(2, np.float32) for agent in made.possible_agents}
    for step in range(15):
        _, rewards, terminated, truncated, infos = made.step(idle)
        last = step == 14
        assert list(terminated.values()) == [False, last, False]
        assert list(truncated.values()) == [last, False, last]
        assert (rewards["rover_1"] > 50.0) == (step == 0)
        assert rewards["rover_1"] == 0.0 or step == 0
        assert infos["rover_1"]["steps"] == 1.0 and infos["rover_0"]["steps"] == step + 1
    assert made.agents == []
    made.close()


def test_groups_without_ends_do_not_keep_an_episode() -> None:
    core = simulation("kinds", task=TWO_STEPS)
    assert [group.ends_episodes for group in core.groups] == [True, True, False, False]
    assert not act(core).done[0]
    step = act(core)
    assert step.done[0] and step.truncated[0]
    assert step.groups["walker"].truncated.all() and not step.groups["walker"].terminated.any()
    core.close()


# -- groups of their own ---------------------------------------------------------------------------


def test_a_crowd_has_one_body_for_each() -> None:
    core = simulation("crowd")
    assert core.group("walker").count == 20
    assert state_of_group(core, "rover").neighbours.shape == (1, 20, 7)
    assert state_of_group(core, "walker").neighbours.shape == (20, 20, 7)
    assert len({name for group in core.groups for name in group.names}) == 21
    start = motion_of_group(core, "walker").position_w.copy()
    ahead = np.zeros((20, 2))
    ahead[::2, 0] = 1.0
    for _ in range(10):
        act(core, walker=ahead)
    moved = np.linalg.norm(motion_of_group(core, "walker").position_w - start, axis=1)
    # Each by its own action; obstacles may stop some.
    np.testing.assert_array_equal(moved[1::2] > 0.0, False)
    assert np.median(moved[::2]) == pytest.approx(0.5, abs=0.01)
    core.close()


def test_groups_of_equal_footprint_search_each_world_once() -> None:
    agents = {
        "one": {"body": "rover_zero"},
        "other": {"body": "rover_zero", "controller": "go_to_goal"},
        "wide": {"body": "rover_zero", "task": {"spawn": {"margin_m": 0.3}}},
        "walker": {"body": "person", "controller": "external"},
    }
    simulation = started_simulation("flat", 1, agents=agents)
    one, other, wide, walker = (group.spawners for group in simulation.groups)
    assert one is other
    assert len({id(each) for each in (one, wide, walker)}) == 3
    simulation.close()


def test_groups_have_their_own_tasks_and_metrics() -> None:
    core = simulation("kinds")
    assert core.metric_names("rover") == core.metric_names("hyperdog")
    assert {"steps", "return", "goals", "reward/progress"} <= {*core.metric_names("walker")}
    assert [group.name for group in core.groups if not group.is_external] == ["walker_b"]
    core.close()
    agents = {
        "scout": {"body": "rover_zero", "task": {"name": "point_goal", "rewards": {"goal": {"weight": 7.0}}}},
        "carrier": {
            "body": "rover_zero",
            "task": {"name": "point_goal", "rewards": {"goal": {"weight": 9.0}}},
        },
    }
    core = started_simulation("flat", 1, agents=agents)
    for name in agents:
        set_goal(core, 0, motion_of_group(core, name).position_w[0, :2], name)
    step = act(core)
    assert step.groups["scout"].reward[0] == 7.0 and step.groups["carrier"].reward[0] == 9.0
    assert metric(core, "reward/goal", "carrier")[0] == 9.0
    assert step.terminated[0]
    core.close()


# -- controllers -----------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["bullet"])
@every_engine
def test_a_behaviour_drives_its_robots_from_goal_to_goal(engine: str) -> None:
    agents = {
        "rover": {"body": "rover_zero", "count": 2, "controller": "go_to_goal"},
        "walker": {"body": "person"},
    }
    spawn = {"region": [-6.0, 6.0, -6.0, 6.0]}
    core = started_simulation("flat", 2, agents=agents, physics=engine, task={"spawn": spawn})
    assert core.agents == ("walker_0",)
    assert not core.group("rover").ends_episodes
    reached = np.zeros(4, int)
    for _ in range(300):
        before = goals_w(core, "rover").copy()
        assert not act(core).done.any()
        reached += (goals_w(core, "rover") != before).any(axis=1)
        if reached.all():
            break
    assert reached.all()
    core.close()


def test_a_policy_drives_its_group_by_what_that_observes() -> None:
    conf = environment_conf(robots=["rover_zero", "rover_zero", "leo_rover"], sensors=["goal", "velocity"])
    given: list[dict[str, Any]] = []

    def policy(seen: dict[str, Any], begins: np.ndarray) -> np.ndarray:
        given.append({name: values.copy() for name, values in seen.items()})
        return np.stack([np.full(len(seen["goal"]), 0.5), seen["goal"][:, 1]], axis=1)

    def make_controller(group: AgentGroup) -> PolicyController:
        assert group.name == "rover"
        return PolicyController(policy)

    setups = [
        replace(setup, controller=make_controller) if setup.name == "rover" else setup
        for setup in group_setups(conf)
    ]
    core = VectorSimulation(
        world=build_world(conf.world),
        groups=setups,
        make_scene=BulletScene,
        physics=conf.physics,
        num_scenes=2,
    )
    core.reset()
    assert core.agents == ("leo_rover_0",)
    for step in range(40):
        expected = observation(core, "rover")
        act(core)
        assert len(given) == step + 1
        assert {name: values.shape for name, values in given[-1].items()} == {
            "goal": (4, 2),
            "velocity": (4, 2),
        }
        for name, values in expected.items():
            np.testing.assert_array_equal(given[-1][name], values)
    speeds = motion_of_group(core, "rover").velocity_b[:, 0]
    np.testing.assert_allclose(speeds, 0.5, atol=0.06)
    # Who is driven from outside stood still.
    assert np.abs(motion_of_group(core, "leo_rover").velocity_w).max() < 0.05
    core.close()


def test_an_agent_with_a_policy_is_not_in_torchrl_s_keys() -> None:
    made = dune_rl.make("flat", 1, agents=EXPLICIT)
    data = made.rollout(2)
    assert set(made.group_map) == {"scout", "carrier"}
    assert not {"guide", "child"} & set(data.keys())
    assert torch.isfinite(data["next", "scout", "reward"]).all()
    made.close()


def test_zero_actions_are_made_for_every_external_group() -> None:
    core = simulation("kinds", 2)
    shapes = {name: values.shape for name, values in rest(core).items()}
    assert shapes == {"rover": (2, 2, 2), "hyperdog": (2, 1, 2), "walker": (2, 2, 2)}
    core.step(rest(core))
    core.close()
