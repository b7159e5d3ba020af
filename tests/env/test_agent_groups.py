"""Agent groups: teams, kinds of robots and crowds of actors, in every interface and on both engines."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from agent_teams import EXPLICIT, SCENES, SHORT, TWO_STEPS, WORLDS, simulation
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
    observation,
    started_simulation,
    state_of_group,
)
from torchrl.envs import TransformedEnv

import dune_rl
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.physics.interface import OWN_ENGINES

AGENTS = {
    "team": ["rover_0", "rover_1", "rover_2"],
    "kinds": ["rover_0", "rover_1", "hyperdog_0", "walker_0", "walker_1"],
    "crowd": ["rover_0", *(f"walker_{number}" for number in range(20))],
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=OWN_ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


def parallel(scene: str, engine: str = "bullet") -> ParallelEnv:
    return dune_rl.parallel_env(WORLDS[scene], overrides=[f"physics={engine}"], task=SHORT, **SCENES[scene])


@pytest.fixture(scope="module")
def env(scene: str, engine: str) -> Iterator[ParallelEnv]:
    made = parallel(scene, engine)
    yield made
    made.close()


@pytest.mark.slow(all_but=["kinds-bullet-*", "team-dart-*"])
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


@pytest.mark.slow(all_but=["team-dart"])
def test_pettingzoo_over_resets(scene: str, engine: str) -> None:
    # Which compares with a fresh environment of the same seed, too.
    check_no_leak(partial(parallel, scene, engine), 20)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["kinds"])
def test_pettingzoo_seeding(scene: str) -> None:
    check_seeding(partial(parallel, scene), 40)


@pytest.mark.slow(all_but=["kinds-bullet", "crowd-dart"])
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
    assert (now.clearance >= nearest - 2 * robot.description.footprint_radius_m - 1e-9).all()
    assert (now.clearance <= nearest - robot.description.width_m + 1e-9).all()
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


@pytest.mark.slow
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
    sensors = {"enabled": ["imu", "goal"], "imu": {"realism": "bno055"}}
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
    sensors = {"enabled": ["imu", "goal"], "imu": {"realism": "bno055"}}
    readings = []
    for count in (1, 2):
        agents = {"rover": {"body": "rover_zero", "count": count}, "other": {"body": "rover_zero"}}
        core = started_simulation("flat", 2, agents=agents, sensors=sensors)
        readings.append(observation(core, "other")["imu"][:, 3:6])
        core.close()
    # They stand still at other places: what their gyroscopes give is noise.
    np.testing.assert_allclose(readings[0], readings[1], atol=1e-3)
