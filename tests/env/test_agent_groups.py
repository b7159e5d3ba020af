"""Agent groups: teams, kinds of robots and crowds of actors, in every interface and on both engines."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from conformance import (
    check_gymnasium,
    check_kept,
    check_no_leak,
    check_parallel_api,
    check_seeding,
    check_spaces,
    check_torchrl,
    check_values,
)
from pettingzoo import ParallelEnv
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
    started_simulation,
    state_of_group,
)
from torchrl.envs import TransformedEnv

import dune_rl
from dune_rl.config.build import build_world, group_setups
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.controllers import PolicyController
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.physics.interface import ENGINES

SHORT = {"terminations": {"time_limit": {"max_steps": 15}}}
TWO_STEPS = {"terminations": {"time_limit": {"max_steps": 2}}}
TWO_WALKERS = [{"controller": "external"}, {"controller": "external"}]
SCRIPTED = {"speed_mps": 0.7}
SCENES: dict[str, dict[str, Any]] = {
    "team": {"robots": ["rover_zero"] * 3, "actors": "none"},
    "kinds": {"robots": ["rover_zero", "rover_zero", "hyperdog"], "actors": [*TWO_WALKERS, SCRIPTED]},
    "crowd": {"robots": ["rover_zero"], "actors": [{"controller": "external"}] * 20},
}
WORLDS = {"team": "flat", "kinds": "inspection", "crowd": "flat"}
AGENTS = {
    "team": ["rover_0", "rover_1", "rover_2"],
    "kinds": ["rover_0", "rover_1", "hyperdog_0", "walker_0", "walker_1"],
    "crowd": ["rover_0", *(f"walker_{number}" for number in range(20))],
}
# Groups as they are configured one by one: equal robots apart by their sensors, and a behaviour beside them.
EXPLICIT: dict[str, Any] = {
    "scout": {
        "body": "rover_zero",
        "count": 2,
        "sensors": ["lidar", "goal"],
        "task": {"name": "point_goal", **SHORT},
    },
    "carrier": {
        "body": "rover_zero",
        "sensors": ["goal", "velocity"],
        "task": {"name": "point_goal", **SHORT},
    },
    "guide": {"body": "leo_rover", "controller": "go_to_goal"},
    "child": {"body": {"name": "person", "height_m": 1.1, "radius_m": 0.2}, "count": 2, "controller": "path"},
}
every_engine = pytest.mark.parametrize("engine", ENGINES)


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


def parallel(scene: str, engine: str = "bullet") -> ParallelEnv:
    return dune_rl.parallel_env(WORLDS[scene], overrides=[f"physics={engine}"], task=SHORT, **SCENES[scene])


def simulation(scene: str, num_scenes: int = 1, **settings: Any) -> VectorSimulation:
    return started_simulation(WORLDS[scene], num_scenes, **{**SCENES[scene], **settings})


# -- conformance -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def env(scene: str, engine: str) -> Iterator[ParallelEnv]:
    made = parallel(scene, engine)
    yield made
    made.close()


@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces])
def test_pettingzoo(check: Callable[[ParallelEnv], None], env: ParallelEnv) -> None:
    check(env)


def test_agents_are_called_by_their_group_and_have_its_spaces(env: ParallelEnv, scene: str) -> None:
    assert env.possible_agents == AGENTS[scene]
    by_group: dict[str, list[str]] = {}
    for agent in env.possible_agents:
        by_group.setdefault(agent.rpartition("_")[0], []).append(agent)
    for first, *others in by_group.values():
        for agent in others:
            assert env.observation_space(agent) == env.observation_space(first)
            assert env.action_space(agent) == env.action_space(first)


def test_pettingzoo_over_resets(scene: str, engine: str) -> None:
    # Which compares with a fresh environment of the same seed, too.
    check_no_leak(partial(parallel, scene, engine), 20)


@pytest.mark.parametrize("scene", ["kinds"])
def test_pettingzoo_seeding(scene: str) -> None:
    check_seeding(partial(parallel, scene), 40)


def test_torchrl(scene: str, engine: str) -> None:
    made = dune_rl.make(WORLDS[scene], 2, overrides=[f"physics={engine}"], task=TWO_STEPS, **SCENES[scene])
    assert [name for names in made.group_map.values() for name in names] == AGENTS[scene]
    assert {key[1] for key in made.observation_spec.keys(True, True)} == {"observation"}
    # Once with what is added to it, once without.
    with_metrics = engine == "bullet"
    if with_metrics:
        made = TransformedEnv(made, EpisodeMetrics())
        assert set(made.metric_names) == {name.rpartition("_")[0] for name in AGENTS[scene]}
    check_torchrl(made)
    made.close()


def test_groups_that_are_configured_one_by_one() -> None:
    made = dune_rl.parallel_env("flat", agents=EXPLICIT)
    assert made.possible_agents == ["scout_0", "scout_1", "carrier_0"]
    assert set(made.observation_space("scout_0")) == {"lidar", "goal"}
    assert set(made.observation_space("carrier_0")) == {"goal", "velocity"}
    assert [group.name for group in made.simulation.groups] == list(EXPLICIT)
    check_parallel_api(made, 20)
    check_values(made, 20)
    made.close()
    check_no_leak(partial(dune_rl.parallel_env, "flat", agents=EXPLICIT), 14)
    batched = dune_rl.make("flat", 2, agents=EXPLICIT)
    assert batched.group_map == {"scout": ["scout_0", "scout_1"], "carrier": ["carrier_0"]}
    check_torchrl(batched)
    batched.close()


BY_BEHAVIOUR = {"body": "rover_zero", "controller": "go_to_goal"}


@pytest.mark.parametrize(
    ("agents", "agent"),
    [
        (
            {
                "rover": {"body": "rover_zero", "task": {"name": "point_goal", **SHORT}},
                "walker": EXPLICIT["child"],
            },
            "rover_0",
        ),
        (
            {
                "dog": {"body": "hyperdog", "task": {"name": "point_goal", **SHORT}},
                "rover": {**BY_BEHAVIOUR, "count": 2},
            },
            "dog_0",
        ),
        ({"rover": BY_BEHAVIOUR, "walker": {"body": "person"}}, "walker_0"),
    ],
    ids=["robot", "robot among robots", "person"],
)
def test_gymnasium_drives_the_one_external_agent(agents: dict[str, Any], agent: str) -> None:
    registered = dune_rl.gym_env("flat", agents=agents)
    assert registered.agent == agent
    first, _ = registered.reset(seed=3)
    assert set(first) == set(registered.observation_space)
    for _ in range(16):
        _, reward, terminated, truncated, _ = registered.step(registered.action_space.sample())
        assert np.isfinite(reward)
        if terminated or truncated:
            break
    # A person goes on from one end of its path to the other.
    assert truncated == (agent != "walker_0") and not terminated
    registered.close()


def test_gymnasium_of_a_person_among_robots() -> None:
    import gymnasium

    agents = {"rover": BY_BEHAVIOUR, "walker": {"body": "person"}}
    made = gymnasium.make("dune_rl/Flat-v0", agents=agents).unwrapped
    check_gymnasium(made)
    made.close()


# -- what agents of a group see of each other ------------------------------------------------------


def test_members_of_a_team_see_each_other() -> None:
    core = simulation("team", 2)
    now = state_of_group(core)
    assert now.neighbours.shape == (6, 2, 7)
    position = now.by_scene(now.motion.position_w)
    for row in range(6):
        others = np.delete(position[row // 3], row % 3, axis=0)
        np.testing.assert_allclose(now.neighbours[row, :, :3], others)
    assert observation(core)["lidar"].shape == (6, 32)
    assert core.observe("rover")["lidar"].shape == (2, 3, 32)
    core.close()


def test_clearance_of_a_team_is_to_its_nearest_member() -> None:
    core = simulation("team", 4)
    now = state_of_group(core)
    robot = core.group("rover").body.robot
    position = now.by_scene(now.motion.position_w[:, :2])
    centres = np.linalg.norm(position[:, :, None] - position[:, None], axis=3)
    centres[:, range(3), range(3)] = np.inf
    nearest = centres.min(axis=2).ravel()
    # Between centres less both circumscribed circles, and less both inscribed ones.
    assert (now.clearance >= nearest - 2 * robot.footprint_radius_m - 1e-9).all()
    assert (now.clearance <= nearest - robot.width_m + 1e-9).all()
    core.close()


def test_neighbours_are_all_moving_bodies_of_the_scene() -> None:
    core = simulation("kinds", 2)
    poses = {}
    for group in core.groups:
        motion = group.body.motion
        parts = motion.position_w, motion.roll_pitch_yaw[:, [2, 0, 1]], motion.frames
        poses[group.name] = np.column_stack(parts).reshape(2, group.count, 7)
    for group in core.groups:
        seen = state_of_group(core, group.name).neighbours.reshape(2, group.count, 5, 7)
        for scene in range(2):
            for agent in range(group.count):
                others = [
                    tuple(pose)
                    for name, found in poses.items()
                    for number, pose in enumerate(found[scene].tolist())
                    if (name, number) != (group.name, agent)
                ]
                assert sorted(map(tuple, seen[scene, agent].tolist())) == sorted(others)
    core.close()


# -- one scene among many, one agent among several -------------------------------------------------


@pytest.mark.parametrize("scene", ["team", "kinds"])
def test_a_scene_among_many_is_the_same_as_alone(scene: str) -> None:
    alone, together = simulation(scene), simulation(scene, 3)
    draws = np.random.default_rng(0)
    for _ in range(5):
        actions = {}
        for group in alone.external:
            low, high = group.action_bounds
            share = 0.1 if group.name == "hyperdog" else 1.0
            actions[group.name] = share * draws.uniform(low, high, (3, group.count, group.action_size))
        act(alone, **{name: values[0] for name, values in actions.items()})
        act(together, **actions)
    for group in alone.external:
        one, three = alone.observe(group.name), together.observe(group.name)
        for name, values in one.items():
            np.testing.assert_array_equal(values[0], three[name][0], err_msg=f"{group.name} {name}")
        np.testing.assert_array_equal(alone.metrics(group.name)[0], together.metrics(group.name)[0])
    alone.close()
    together.close()


def test_noise_of_the_agents_of_a_team_differs() -> None:
    # Seen standing still, a true reading would be the same for all.
    sensors = {"enabled": ["imu", "goal"], "realism": {"imu": "bno055"}}
    core = simulation("team", 2, sensors=sensors)
    readings = []
    for _ in range(5):
        act(core)
        readings.append(observation(core)["imu"][:, 3:6])
    rates = np.array(readings)
    assert np.abs(rates).max() < 0.2
    for one in range(6):
        for other in range(one):
            assert not np.array_equal(rates[:, one], rates[:, other])
    core.close()


def test_an_agent_more_changes_no_noise_of_other_groups() -> None:
    sensors = {"enabled": ["imu", "goal"], "realism": {"imu": "bno055"}}
    readings = []
    for count in (1, 2):
        agents = {"rover": {"body": "rover_zero", "count": count}, "other": {"body": "rover_zero"}}
        core = started_simulation("flat", 2, agents=agents, sensors=sensors)
        readings.append(observation(core, "other")["imu"][:, 3:6])
        core.close()
    # They stand still at other places: what their gyroscopes give is noise.
    np.testing.assert_allclose(readings[0], readings[1], atol=1e-3)


# -- ends ------------------------------------------------------------------------------------------


def test_members_that_are_done_wait_for_the_others() -> None:
    core = simulation("team")
    goals_w(core)[0] = motion_of_group(core).position_w[0, :2]
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
    goals_w(core)[1] = motion_of_group(core).position_w[1, :2]
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
        goals_w(core, name)[0] = motion_of_group(core, name).position_w[0, :2]
    step = act(core)
    assert step.groups["scout"].reward[0] == 7.0 and step.groups["carrier"].reward[0] == 9.0
    assert metric(core, "reward/goal", "carrier")[0] == 9.0
    assert step.terminated[0]
    core.close()


# -- controllers -----------------------------------------------------------------------------------


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

    def policy(seen: dict[str, Any]) -> np.ndarray:
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
